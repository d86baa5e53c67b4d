//! The ground table against numbers that the reference implementation's own functions gave on a KITTI calibration.

use gedepth_core::camera::{ImageSize, Intrinsics, Pinhole};
use gedepth_core::table::{GroundCoefficients, GroundView};
use gedepth_core::{Error, Extrinsics, Ground, GroundPlane};

/// KITTI 2011_09_26: `K` of P2, and `R`, `T` with `K [R T] = P2 R0_rect Tr_velo_to_cam`; the LiDAR's z points up.
fn kitti() -> Result<(Pinhole, Ground), Error> {
    let k = [
        [721.5377, 0.0, 609.5593],
        [0.0, 721.5377, 172.854],
        [0.0, 0.0, 1.0],
    ];
    let r = [
        [
            2.3477369814704142e-4,
            -9.999441545437641e-1,
            -1.0563477811052201e-2,
        ],
        [
            1.0449407416592844e-2,
            1.056535364137932e-2,
            -9.99889574117649e-1,
        ],
        [
            9.999453885620024e-1,
            1.2436537838650679e-4,
            1.0451302995668946e-2,
        ],
    ];
    let t = [
        0.05705244785953045,
        -0.07546671853346003,
        -0.2693869124058732,
    ];
    let camera = Pinhole::new(Intrinsics::from_matrix(ImageSize::new(1242, 375)?, k)?);
    let ground = Ground::seen_by(
        &Extrinsics::world_to_camera(r, t)?,
        &GroundPlane::z_up(-1.65)?,
    )?;
    Ok((camera, ground))
}

/// (row, column, reference depth in metres, negative above the vanishing line).
const REFERENCE: [(u32, u32, f64); 9] = [
    (0, 0, -6.094572064317271),
    (374, 0, 6.083866742255532),
    (374, 1236, 5.687095107975469),
    (180, 600, -2291.8808081202255),
    (176, 1200, 618.1934695618058),
    (172, 0, -76.7533254636052),
    (173, 0, -82.30084173228032),
    (175, 0, -96.20815604361277),
    (250, 618, 16.338480985480373),
];

#[test]
fn table_agrees_with_the_reference() -> Result<(), Error> {
    let (camera, ground) = kitti()?;
    let mut memory = vec![0.0; 1242 * 375];
    let table = GroundView::build(&mut memory, &camera, &ground)?;
    for (row, column, reference) in REFERENCE {
        let inverse = f64::from(table.inverse_depth(column, row).unwrap_or(f32::NAN));
        let absolute = (inverse - 1.0 / reference).abs();
        assert!(
            absolute <= 1e-5 / reference.abs().min(200.0),
            "row {row}, column {column}: {} m, reference {reference} m",
            1.0 / inverse
        );
        let depth = table.depth(column, row);
        assert_eq!(
            depth == Some(0.0),
            reference < 0.0,
            "row {row}, column {column}"
        );
    }
    Ok(())
}

#[test]
fn coefficients_agree_with_the_reference_in_full_precision() -> Result<(), Error> {
    let (camera, ground) = kitti()?;
    let coefficients = GroundCoefficients::new(camera.intrinsics(), &ground);
    for (row, column, reference) in REFERENCE {
        let inverse = coefficients.inverse_depth(f64::from(column), f64::from(row));
        assert!(
            (inverse * reference - 1.0).abs() < 1e-9,
            "row {row}, column {column}"
        );
    }
    Ok(())
}
