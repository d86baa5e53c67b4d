//! `gedepth inspect` as a user calls it.
#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::process::{Command, Output};

fn inspect(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gedepth"));
    command.arg("inspect").args(arguments).output().unwrap()
}

fn model(name: &str) -> String {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/models");
    models.join(name).to_str().unwrap().to_owned()
}

#[test]
fn the_embedded_model_is_described() {
    let output = inspect(&[]);
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    for words in [
        "contract    mode = adaptive",
        "input       input [1, 4, height, width]",
        "output      residual",
        "weights     ",
        "runs        by ",
        "Conv ",
    ] {
        assert!(text.contains(words), "`{words}` is not in:\n{text}");
    }
}

#[test]
fn json_says_the_same() {
    let output = inspect(&[&model("adaptive-int8.onnx"), "--json"]);
    assert!(output.status.success());
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["contract"]["mode"], "adaptive");
    assert_eq!(json["inputs"][0]["shape"][1], "4");
    assert!(json["weights"]["numbers"].as_u64().unwrap() > 1_000_000);
    let nodes = json["nodes"].as_array().unwrap();
    assert!(nodes.len() > 100);
    if json["plan"]["by"] == "engine" {
        for node in nodes {
            assert_eq!(node["runs_in"], "engine", "{node}");
        }
    }
}

#[test]
fn a_network_in_f32_is_tracts() {
    let output = inspect(&[&model("baseline-f32.onnx"), "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["plan"]["by"], "tract");
    for node in json["nodes"].as_array().unwrap() {
        assert_eq!(node["runs_in"], "tract");
        assert!(!node["reason"].as_str().unwrap().is_empty(), "{node}");
    }
}

#[test]
fn what_is_no_model_is_refused() {
    let output = inspect(&["Cargo.toml"]);
    assert_eq!(output.status.code(), Some(5));
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(
        message.contains("Cargo.toml: cannot run the model: not an ONNX file"),
        "{message}"
    );
}
