//! The model contract: what is missing, malformed or contradictory is named.
#![allow(clippy::unwrap_used, clippy::panic)]

use gedepth::contract::{Channel, Contract, ContractError, Fit, GroundChannel, Mode, ResidualForm};

const ADAPTIVE: [(&str, &str); 23] = [
    ("gedepth.contract", "1"),
    ("gedepth.mode", "adaptive"),
    ("gedepth.fusion", "runtime"),
    ("gedepth.input", "input"),
    ("gedepth.channels", "red,green,blue,inverse_ground_depth"),
    ("gedepth.mean", "123.675,116.28,103.53"),
    ("gedepth.std", "58.395,57.12,57.375"),
    ("gedepth.size_multiple", "32"),
    ("gedepth.nominal_size", "640x192"),
    ("gedepth.ground_scale_m", "8"),
    ("gedepth.ground_limit", "2.5"),
    ("gedepth.residual", "residual"),
    ("gedepth.residual_form", "log_depth"),
    ("gedepth.attention", "attention"),
    ("gedepth.attention_form", "logit"),
    ("gedepth.slope", "slope"),
    ("gedepth.slope_angles_deg", "-5,-4,-3,-2,-1,0,1,2,3,4,5"),
    ("gedepth.slope_sign", "downhill_positive"),
    ("gedepth.slope_order", "softmax_then_upsample"),
    ("gedepth.upsampling", "half_pixel"),
    ("gedepth.depth_range_m", "0.5,80"),
    ("gedepth.network", "a network"),
    ("gedepth.training", "somehow"),
];

/// The adaptive contract with entries replaced (`Some`) or left out (`None`), and more added.
fn changed(changes: &[(&str, Option<&str>)]) -> Result<Contract, ContractError> {
    let mut entries: Vec<(String, String)> =
        ADAPTIVE.map(|(k, v)| (k.to_owned(), v.to_owned())).to_vec();
    for (entry, value) in changes {
        let key = format!("gedepth.{entry}");
        entries.retain(|(k, _)| *k != key);
        entries.extend(value.map(|value| (key, value.to_owned())));
    }
    Contract::from_metadata(entries.iter().map(|(k, v)| (k.as_str(), v.as_str())))
}

#[test]
fn an_adaptive_contract_is_read() {
    let contract = changed(&[]).unwrap();
    assert_eq!(contract.mode, Mode::Adaptive);
    assert_eq!(
        contract.channels[3],
        Channel::Ground(GroundChannel::InverseDepth)
    );
    assert_eq!(contract.nominal_size, (640, 192));
    assert_eq!(contract.fit, Fit::Resize);
    assert_eq!(
        (contract.depth_range.min(), contract.depth_range.max()),
        (0.5, 80.0)
    );
    let classes = contract.slope.unwrap().classes;
    assert_eq!(classes.radians().len(), 11);
    assert!((classes.radians()[10] - 5f32.to_radians()).abs() < 1e-6);
}

#[test]
fn slope_classes_that_count_uphill_are_turned_over() {
    let contract = changed(&[("slope_sign", Some("uphill_positive"))]).unwrap();
    assert!((contract.slope.unwrap().classes.radians()[10] + 5f32.to_radians()).abs() < 1e-6);
}

#[test]
fn each_missing_entry_is_named() {
    for (key, _) in ADAPTIVE {
        let entry = key.strip_prefix("gedepth.").unwrap();
        match (entry, changed(&[(entry, None)])) {
            ("network" | "training", contract) => assert!(contract.is_ok()),
            ("contract", contract) => assert_eq!(contract, Err(ContractError::Absent)),
            (_, contract) => {
                let message = contract.unwrap_err().to_string();
                assert!(
                    message.contains(&format!("lacks the entry `{key}`")),
                    "{message}"
                );
            }
        }
    }
}

#[test]
fn each_malformed_entry_is_named_with_its_value() {
    for (entry, value) in [
        ("contract", "2"),
        ("mode", "magic"),
        ("fusion", "cold"),
        ("input", ""),
        ("channels", "red,green"),
        ("channels", "red,green,blue,red"),
        ("channels", "red,green,blue,infrared"),
        ("mean", "1,2"),
        ("mean", "1,2,NaN"),
        ("std", "1,2,0"),
        // Of pictures in 0 to 1, by mistake.
        ("std", "0.229,0.224,0.225"),
        ("std", "1,2,inf"),
        ("size_multiple", "0"),
        ("size_multiple", "-32"),
        ("nominal_size", "640"),
        ("nominal_size", "640x190"),
        ("nominal_size", "0x0"),
        ("fit", "stretch"),
        ("ground_scale_m", "0"),
        ("ground_limit", "NaN"),
        ("residual_form", "disparity"),
        ("attention_form", "maybe"),
        ("slope_angles_deg", "5,4,3"),
        ("slope_angles_deg", "0,40"),
        ("slope_angles_deg", "a,b"),
        ("slope_angles_deg", ""),
        ("slope_sign", "up"),
        ("slope_order", "never"),
        ("upsampling", "nearest"),
        ("depth_range_m", "80,0.5"),
        ("depth_range_m", "0,80"),
        ("depth_range_m", "1,inf"),
        ("depth_range_m", "1"),
    ] {
        let message = changed(&[(entry, Some(value))]).unwrap_err().to_string();
        assert!(
            message.contains(&format!("gedepth.{entry}")),
            "{entry}={value}: {message}"
        );
        assert!(message.contains("expected"), "{entry}={value}: {message}");
    }
}

#[test]
fn contradictions_and_unknown_entries_are_refused() {
    for (named, changes) in [
        // A baseline must not see the ground, nor have heads for it.
        ("channels", vec![("mode", Some("baseline"))]),
        (
            "attention",
            vec![
                ("mode", Some("baseline")),
                ("channels", Some("red,green,blue")),
                ("ground_scale_m", None),
                ("ground_limit", None),
            ],
        ),
        // A vanilla network has no slope.
        ("slope", vec![("mode", Some("vanilla"))]),
        // In-graph fusion leaves no heads.
        ("attention", vec![("fusion", Some("graph"))]),
        // Scales without a channel that they scale.
        ("ground_limit", vec![("channels", Some("red,green,blue"))]),
    ] {
        match changed(&changes) {
            Err(ContractError::Contradictory { entry, .. }) => assert_eq!(entry, named),
            other => panic!("{changes:?}: {other:?}"),
        }
    }
    let unknown = changed(&[("temperature", Some("2"))]);
    assert_eq!(
        unknown,
        Err(ContractError::Unknown("temperature".to_owned()))
    );
}

#[test]
fn residuals_have_the_form_that_is_said() {
    for (value, form) in [
        ("depth", ResidualForm::Depth),
        ("log_depth", ResidualForm::LogDepth),
        ("log_metres_per_pixel", ResidualForm::LogMetresPerPixel),
    ] {
        let contract = changed(&[("residual_form", Some(value))]).unwrap();
        assert_eq!(contract.residual_form, form);
    }
}

/// ONNX allows it, and readers differ in which they take.
#[test]
fn repeated_entries_are_refused() {
    let again = [("gedepth.slope_sign", "uphill_positive")];
    let refused = Contract::from_metadata(ADAPTIVE.into_iter().chain(again)).unwrap_err();
    assert_eq!(refused, ContractError::Repeated("slope_sign".to_owned()));
    assert!(
        refused
            .to_string()
            .contains("`gedepth.slope_sign` more than once")
    );
}

#[test]
fn foreign_metadata_is_ignored() {
    let foreign = [("author", "somebody")];
    assert!(Contract::from_metadata(ADAPTIVE.into_iter().chain(foreign)).is_ok());
    assert_eq!(Contract::from_metadata(foreign), Err(ContractError::Absent));
}
