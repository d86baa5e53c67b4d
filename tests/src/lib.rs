#![allow(clippy::panic, clippy::expect_used)] // a test that cannot go on says why
//! What the tests of this folder share: the shipped scenes, real driving data where a developer has it, and depth
//! files in KITTI's convention.

use std::path::{Path, PathBuf};

/// The repository's root.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The folders of the shipped scenes, each with `image.png`, `depth.png` and `calibration.json`.
pub fn shipped_scenes() -> Vec<PathBuf> {
    let scenes = folders(&root().join("fixtures/scenes"));
    assert!(!scenes.is_empty(), "fixtures/scenes is empty");
    scenes
}

/// Real driving data beside the repository, which only developers have: its licences keep it out of the project.
/// `None` where it is absent; the caller's test is then skipped, and this says so.
pub fn real_data(part: &str) -> Option<PathBuf> {
    let path = root().join("../shared/data").join(part);
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("skipped: there is no ../shared/data/{part} beside the repository");
    None
}

/// The folders in `parent`, sorted.
pub fn folders(parent: &Path) -> Vec<PathBuf> {
    let mut folders: Vec<_> = std::fs::read_dir(parent)
        .unwrap_or_else(|e| panic!("{}: {e}", parent.display()))
        .map(|entry| entry.expect("a readable folder").path())
        .filter(|path| path.is_dir())
        .collect();
    folders.sort();
    folders
}

/// The picture of a frame's folder.
pub fn picture(frame: &Path) -> PathBuf {
    ["image.png", "image.jpg"]
        .map(|name| frame.join(name))
        .into_iter()
        .find(|path| path.exists())
        .unwrap_or_else(|| panic!("{} has no picture", frame.display()))
}

/// A 16-bit depth file in KITTI's convention as metres, 0 where nothing was measured; width, height, values.
pub fn depth(path: &Path) -> (u32, u32, Vec<f32>) {
    let image = image::open(path)
        .unwrap_or_else(|e| panic!("{}: {e}", path.display()))
        .into_luma16();
    let metres = image
        .as_raw()
        .iter()
        .map(|&steps| f32::from(steps) / 256.0)
        .collect();
    (image.width(), image.height(), metres)
}

/// Mean of `|estimate - truth| / truth` over the pixels measured within `cap` metres.
pub fn abs_rel(estimate: &[f32], truth: &[f32], cap: f32) -> f64 {
    assert_eq!(estimate.len(), truth.len());
    let errors: Vec<f64> = estimate
        .iter()
        .zip(truth)
        .filter(|&(_, &z)| z > 0.0 && z <= cap)
        .map(|(&e, &z)| f64::from((e - z).abs() / z))
        .collect();
    errors.iter().sum::<f64>() / errors.len() as f64
}
