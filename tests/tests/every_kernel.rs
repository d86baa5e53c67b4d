//! The same depth, to the last bit, from every kernel of the quantized engine. What is printed says so of processors
//! too: `.ci/arm` holds it against another one's.
#![allow(clippy::expect_used)] // a test that cannot go on says why

use gedepth::{Calibration, Engine, Estimator, Kernel, Model, OutputSize, Picture, picture};
use gedepth_tests::shipped_scenes;

/// FNV-1a of the bits of some values.
fn digest<'a>(values: impl Iterator<Item = &'a f32>) -> u64 {
    values
        .flat_map(|value| value.to_bits().to_le_bytes())
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3)
        })
}

#[test]
fn every_kernel_gives_the_same_depth() {
    for scene in shipped_scenes() {
        let image = picture::read(&gedepth_tests::picture(&scene)).expect("a picture");
        let calibration = Calibration::read(&scene.join("calibration.json")).expect("one");
        let mut digests = Vec::new();
        for kernel in Kernel::ALL.into_iter().filter(|k| k.is_supported()) {
            let engine = Engine::Quantized { kernel, threads: 1 };
            let model = Model::embedded()
                .expect("the embedded model")
                .with_engine(engine);
            let size = Some((320, 96));
            let mut estimator = Estimator::new(
                &model,
                &calibration,
                image.dimensions(),
                size,
                OutputSize::Picture,
            )
            .expect("an estimator");
            estimator.run(Picture::from(&image)).expect("depth");
            let maps = estimator.maps().expect("maps");
            let attention = maps.attention.expect("an adaptive network's attention");
            let values = maps.depth.iter().chain(maps.ground).chain(attention);
            digests.push((kernel, digest(values)));
        }
        let (_, first) = digests[0];
        assert!(
            digests.iter().all(|(_, digest)| *digest == first),
            "{digests:x?}"
        );
        let name = scene.file_name().expect("a folder").to_string_lossy();
        println!("depth of {name}: {first:016x}");
    }
}

/// And none where another would have run the network in its place, in other roundings.
#[test]
fn an_engine_that_cannot_be_had_is_refused() {
    let scene = shipped_scenes().remove(0);
    let image = picture::read(&gedepth_tests::picture(&scene)).expect("a picture");
    let calibration = Calibration::read(&scene.join("calibration.json")).expect("one");
    let absent = Kernel::ALL.into_iter().filter(|k| !k.is_supported());
    let engines = absent
        .map(|kernel| (kernel, 1))
        .chain([65, usize::MAX].map(|threads| (Kernel::Portable, threads)));
    for (kernel, threads) in engines {
        let model = Model::embedded()
            .expect("the embedded model")
            .with_engine(Engine::Quantized { kernel, threads });
        let size = image.dimensions();
        let refused =
            Estimator::new(&model, &calibration, size, None, OutputSize::Picture).map(|_| ());
        assert!(
            matches!(refused, Err(gedepth::Error::Engine { .. })),
            "{kernel:?}, {threads} threads: {refused:?}"
        );
    }
}
