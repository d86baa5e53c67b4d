//! Fusion gives the same bytes whatever vectors it was compiled for.
#![cfg(target_arch = "x86_64")]
#![allow(clippy::unwrap_used)]

use gedepth_core::camera::ImageSize;
use gedepth_core::fusion::{
    AttentionHead, AttentionUnit, DecodeAt, DepthRange, FusedMaps, Fusion, HeadMap, ResidualHead,
    ResidualUnit, Samples, SlopeHead, Upsampling, scratch_len,
};
use gedepth_core::slope::{SlopeClasses, SlopeSign};
use gedepth_core::table::GroundView;
use gedepth_core::{Angle, Error};

fn wave(count: usize, scale: f32, offset: f32) -> Vec<f32> {
    (0..count)
        .map(|i| (i as f32 * 0.37).sin() * scale + offset)
        .collect()
}

#[inline(always)]
fn fuse(at: DecodeAt, upsampling: Upsampling) -> Result<Vec<u32>, Error> {
    let (size, head) = (ImageSize::new(148, 36)?, ImageSize::new(37, 9)?);
    let inverse = wave(size.pixels(), 0.3, 0.1);
    let ground = GroundView::from_values(&inverse, size, 1.65)?;
    let classes: SlopeClasses = SlopeClasses::uniform(
        Angle::from_degrees(-5.0),
        Angle::from_degrees(5.0),
        11,
        SlopeSign::DownhillPositive,
    )?;
    let (residual, attention) = (wave(head.pixels(), 1.0, 2.5), wave(head.pixels(), 4.0, 0.0));
    let slope = wave(11 * head.pixels(), 3.0, 0.0);
    let residual = ResidualHead {
        map: HeadMap::new(Samples::F32(&residual), 1, head)?,
        unit: ResidualUnit::LogMetres,
        decode_at: at,
    };
    let attention = AttentionHead {
        map: HeadMap::new(Samples::F32(&attention), 1, head)?,
        unit: AttentionUnit::Logit,
        decode_at: at,
    };
    let slope = SlopeHead {
        map: HeadMap::new(Samples::F32(&slope), 11, head)?,
        classes: &classes,
        decode_at: at,
    };
    let mut scratch = vec![0.0; scratch_len(size, head.width(), 11)];
    let mut depth = vec![0.0; size.pixels()];
    let maps = FusedMaps {
        depth: &mut depth,
        attention: None,
        ground: None,
    };
    Fusion::new(upsampling, DepthRange::new(0.1, 80.0)?, 150.0)?.adaptive(
        &ground,
        &residual,
        &attention,
        &slope,
        &mut scratch,
        maps,
    )?;
    Ok(depth.into_iter().map(f32::to_bits).collect())
}

#[target_feature(enable = "avx2,fma")]
fn avx2(at: DecodeAt, upsampling: Upsampling) -> Result<Vec<u32>, Error> {
    fuse(at, upsampling)
}

#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512dq,avx2,fma")]
fn avx512(at: DecodeAt, upsampling: Upsampling) -> Result<Vec<u32>, Error> {
    fuse(at, upsampling)
}

#[test]
fn same_bytes() {
    for at in [DecodeAt::HeadSize, DecodeAt::OutputSize] {
        for upsampling in [Upsampling::HalfPixel, Upsampling::AlignCorners] {
            let plain = fuse(at, upsampling).unwrap();
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                // SAFETY: the processor has these features.
                assert!(unsafe { avx2(at, upsampling) }.unwrap() == plain);
            } else {
                println!("skipped: no AVX2");
            }
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
            {
                // SAFETY: the processor has these features.
                assert!(unsafe { avx512(at, upsampling) }.unwrap() == plain);
            } else {
                println!("skipped: no AVX-512");
            }
        }
    }
}
