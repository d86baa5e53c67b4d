//! Every error code, reached through the safe interface; the numbers are part of the interface.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;

use gedepth_core::camera::{BrownConrady, ImageSize, Intrinsics, KannalaBrandt};
use gedepth_core::fusion::{
    AttentionHead, AttentionUnit, DecodeAt, DepthRange, FusedMaps, Fusion, HeadMap,
    ReferenceFusion, ResidualHead, ResidualUnit, Samples, SlopeHead, Upsampling,
    reference_scratch_len, scratch_len,
};
use gedepth_core::metrics::{ByDistance, CloudMatches};
use gedepth_core::slope::{SlopeClasses, SlopeSign};
use gedepth_core::table::{
    Coverage, GroundCoefficients, GroundLut, GroundRows, GroundView, RowLut, RowTolerance,
};
use gedepth_core::{
    Angle, CameraFrame, Direction, Error, Extrinsics, Ground, GroundPlane, Mounting, WorldFrame,
};

const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Code, and what the message must mention.
fn expect<T>(
    result: Result<T, Error>,
    code: u16,
    mentions: &str,
    seen: &mut BTreeMap<u16, String>,
) {
    let error = result.err().unwrap();
    assert_eq!(error.code(), code, "{error}");
    let message = error.to_string();
    assert!(
        message.contains(mentions),
        "{message:?} does not mention {mentions:?}"
    );
    seen.insert(code, message);
}

#[test]
fn every_code_is_reached_and_says_what_was_wrong() {
    let mut all = BTreeMap::new();
    let seen = &mut all;
    let size = ImageSize::new(4, 3).unwrap();
    let k = Intrinsics::centred(size, 2.0).unwrap();
    for (w, h) in [(0, 5), (5, 0), (65_536, 5), (5, 65_536)] {
        expect(ImageSize::new(w, h), 101, &format!("{w}x{h}"), seen);
    }
    for focal in [0.0, -700.0, 1e8, 0.001, f64::NAN, f64::INFINITY] {
        expect(
            Intrinsics::new(size, focal, 1.0, 0.0, 0.0),
            102,
            &focal.to_string(),
            seen,
        );
        expect(
            Intrinsics::new(size, 1.0, focal, 0.0, 0.0),
            102,
            &focal.to_string(),
            seen,
        );
    }
    for centre in [f64::NAN, 2e6, -2e6] {
        expect(
            Intrinsics::new(size, 1.0, 1.0, centre, 0.0),
            103,
            &centre.to_string(),
            seen,
        );
        expect(
            Intrinsics::new(size, 1.0, 1.0, 0.0, centre),
            103,
            &centre.to_string(),
            seen,
        );
    }
    expect(k.with_skew(f64::NAN), 104, "NaN", seen);
    expect(k.with_skew(2e6), 104, "2000000", seen);
    for (row, column, value) in [(1, 0, 0.5), (2, 0, 1.0), (2, 1, f64::NAN), (2, 2, 0.0)] {
        let mut matrix = IDENTITY;
        matrix[row][column] = value;
        expect(
            Intrinsics::from_matrix(size, matrix),
            105,
            &format!("[{row}][{column}] is {value}"),
            seen,
        );
    }
    // A singular K.
    expect(
        Intrinsics::from_matrix(size, [[0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        102,
        "0",
        seen,
    );
    expect(
        BrownConrady::new(k, [0.0, 0.0, f64::NAN, 0.0, 0.0]),
        106,
        "2 is NaN",
        seen,
    );
    expect(
        KannalaBrandt::new(k, [0.0, 0.0, 0.0, -1e7]),
        106,
        "3 is -10000000",
        seen,
    );
    for (left, top, width, height) in [
        (1, 0, 4, 1),
        (0, 1, 1, 3),
        (u32::MAX, 0, 1, 1),
        (0, u32::MAX, 1, 1),
    ] {
        let part = ImageSize::new(width, height).unwrap();
        expect(k.crop(left, top, part), 107, &left.to_string(), seen);
    }
    expect(k.bin(0), 108, "0", seen);
    expect(k.bin(4), 108, "4", seen);

    for vector in [
        [0.0; 3],
        [f64::NAN, 0.0, 0.0],
        [f64::INFINITY, 0.0, 0.0],
        [1e-320, 0.0, 0.0],
        [0.0, 0.0, 2e-162],
        [0.0, 1e160, 0.0],
    ] {
        let [x, y, z] = vector;
        expect(
            Direction::<CameraFrame>::new(x, y, z),
            201,
            "direction",
            seen,
        );
    }
    let mut bent = IDENTITY;
    bent[0][1] = 0.002;
    expect(
        Extrinsics::world_to_camera(bent, [0.0; 3]),
        202,
        "0.002",
        seen,
    );
    bent[0][1] = f64::NAN;
    expect(
        Extrinsics::world_to_camera(bent, [0.0; 3]),
        202,
        "NaN",
        seen,
    );
    expect(
        Extrinsics::world_to_camera([[0.0; 3]; 3], [0.0; 3]),
        202,
        "by 1",
        seen,
    );
    let mut mirror = IDENTITY;
    mirror[2][2] = -1.0;
    expect(
        Extrinsics::world_to_camera(mirror, [0.0; 3]),
        203,
        "-1",
        seen,
    );
    expect(
        Extrinsics::world_to_camera(IDENTITY, [0.0, f64::NAN, 0.0]),
        204,
        "NaN",
        seen,
    );
    expect(
        Extrinsics::world_to_camera(IDENTITY, [0.0, 0.0, 2e9]),
        204,
        "2000000000",
        seen,
    );
    let nan = Angle::from_radians(f64::NAN);
    expect(
        Ground::from_mounting(1.0, nan, Angle::ZERO),
        205,
        "NaN",
        seen,
    );
    let mut mounting = Mounting {
        height: 1.0,
        pitch: Angle::ZERO,
        roll: Angle::ZERO,
        yaw: nan,
    };
    expect(Extrinsics::from_mounting(&mounting), 205, "NaN", seen);
    mounting.yaw = Angle::from_radians(f64::INFINITY);
    expect(Extrinsics::from_mounting(&mounting), 205, "inf", seen);
    // Rounded as files are, a rotation is accepted.
    bent[0][1] = 0.001;
    assert!(Extrinsics::world_to_camera(bent, [0.0; 3]).is_ok());

    let up: Direction<WorldFrame> = Direction::new(0.0, 0.0, 1.0).unwrap();
    for offset in [f64::NAN, 2e9, -2e9] {
        expect(GroundPlane::new(up, offset), 301, &offset.to_string(), seen);
    }
    let down: Direction<CameraFrame> = Direction::new(0.0, 1.0, 0.0).unwrap();
    for height in [0.0, -1.5, 0.0009, 2e5, 2e9, -2e9, f64::NAN, f64::INFINITY] {
        expect(Ground::new(down, height), 302, &height.to_string(), seen);
        expect(
            Ground::from_mounting(height, Angle::ZERO, Angle::ZERO),
            302,
            "height",
            seen,
        );
    }
    // Under the plane, and on it.
    let camera = Extrinsics::world_to_camera(IDENTITY, [0.0; 3]).unwrap();
    expect(
        Ground::seen_by(&camera, &GroundPlane::z_up(0.5).unwrap()),
        302,
        "-0.5",
        seen,
    );
    expect(
        Ground::seen_by(&camera, &GroundPlane::y_down(0.0).unwrap()),
        302,
        "sign",
        seen,
    );

    let ground = Ground::from_mounting(1.0, Angle::ZERO, Angle::from_degrees(20.0)).unwrap();
    let pinhole = gedepth_core::camera::Pinhole::new(k);
    expect(
        GroundLut::<11>::new().build(&pinhole, &ground),
        401,
        "11 values, 12",
        seen,
    );
    expect(
        GroundView::from_values(&[0.0; 13], size, 1.0),
        401,
        "13 values, 12",
        seen,
    );
    expect(
        GroundView::from_values(&[0.0; 12], size, 0.0),
        302,
        "0",
        seen,
    );
    expect(GroundLut::<12>::new().view(), 402, "never built", seen);
    let tolerance = RowTolerance {
        relative_error: 0.01,
        up_to: 100.0,
    };
    let coefficients = GroundCoefficients::new(&k, &ground);
    expect(
        RowLut::<3>::new().build(&coefficients, tolerance),
        403,
        "rolls",
        seen,
    );
    let lax = RowTolerance {
        relative_error: f64::NAN,
        up_to: 100.0,
    };
    expect(
        RowLut::<3>::new().build(&coefficients, lax),
        403,
        "rolls",
        seen,
    );
    expect(
        RowLut::<2>::new().build(&coefficients, tolerance),
        401,
        "2 values, 3",
        seen,
    );
    expect(coefficients.write_row(3, &mut [0.0; 4]), 404, "row 3", seen);
    expect(
        Coverage::of(&coefficients, &mut [0.0; 3]),
        608,
        "3 values, 4",
        seen,
    );
    let mut metres = [0.0; 11];
    let short = gedepth_core::table::write_depth(&coefficients, 80.0, &mut metres);
    expect(short, 607, "11 values, 12", seen);

    let classes = |angles: &[Angle]| SlopeClasses::<2>::new(angles, SlopeSign::DownhillPositive);
    expect(classes(&[]), 501, "0 slope classes", seen);
    expect(classes(&[Angle::from_degrees(31.0)]), 502, "31", seen);
    let one = classes(&[Angle::ZERO]).unwrap();
    expect(
        one.expected_angle(&[1.0, 2.0]),
        503,
        "2 slope logits for 1",
        seen,
    );
    expect(one.expected_angle(&[f32::NAN]), 504, "0", seen);

    expect(
        HeadMap::new(Samples::F32(&[0.0; 11]), 1, size),
        601,
        "11 values, its shape needs 12",
        seen,
    );
    let eight_bit = Samples::U8 {
        values: &[0; 12],
        scale: 0.0,
        zero_point: 0,
    };
    expect(HeadMap::new(eight_bit, 1, size), 604, "scale 0", seen);
    expect(DepthRange::new(2.0, 1.0), 605, "2 to 1", seen);
    let range = DepthRange::new(1.0, 2.0).unwrap();
    expect(
        Fusion::new(Upsampling::HalfPixel, range, 0.0),
        606,
        "0 m",
        seen,
    );
    expect(ByDistance::new([2.0, 1.0]), 701, "1 of", seen);
    let cloud: [gedepth_core::Point<CameraFrame>; 0] = [];
    expect(
        CloudMatches::new().add(&cloud, &cloud, 0.0, &mut []),
        702,
        "0 m",
        seen,
    );

    // Heads of the picture's size, of which each is spoilt in turn.
    let values = [0.5; 24];
    let map = |values: &'static [f32], channels| HeadMap::new(Samples::F32(values), channels, size);
    let good = map(&[0.5; 12], 1).unwrap();
    let double = HeadMap::new(Samples::F32(&values), 2, size).unwrap();
    let nan = map(&[f32::NAN; 12], 1).unwrap();
    let infinite = map(&[f32::INFINITY; 12], 1).unwrap();
    let at = DecodeAt::HeadSize;
    let fuse = |residual, attention, slope| {
        let mut depth = [0.0; 12];
        let mut scratch = vec![0.0; scratch_len(size, 4, 1)];
        Fusion::new(Upsampling::HalfPixel, range, 100.0)?.adaptive(
            &coefficients,
            &ResidualHead {
                map: residual,
                unit: ResidualUnit::Metres,
                decode_at: at,
            },
            &AttentionHead {
                map: attention,
                unit: AttentionUnit::Logit,
                decode_at: at,
            },
            &SlopeHead {
                map: slope,
                classes: &one,
                decode_at: at,
            },
            &mut scratch,
            FusedMaps {
                depth: &mut depth,
                ..FusedMaps::default()
            },
        )
    };
    assert_eq!(fuse(good, good, good), Ok(()));
    for (focal_length, said) in [
        (0.0, "0"),
        (-200.0, "-200"),
        (f32::NAN, "NaN"),
        (f32::INFINITY, "inf"),
    ] {
        let residual = ResidualHead {
            map: good,
            unit: ResidualUnit::LogMetresPerPixel { focal_length },
            decode_at: at,
        };
        let (mut scratch, mut depth) = (vec![0.0; scratch_len(size, 4, 0)], [-1.0; 12]);
        let made = Fusion::new(Upsampling::HalfPixel, range, 100.0)
            .and_then(|fusion| fusion.baseline(size, &residual, &mut scratch, &mut depth));
        expect(made, 102, said, seen);
        assert_eq!(depth, [-1.0; 12], "nothing is written");
    }
    expect(fuse(double, good, good), 602, "2 channels", seen);
    expect(fuse(good, double, good), 602, "2 channels", seen);
    expect(fuse(good, good, double), 503, "2 slope logits for 1", seen);
    expect(fuse(nan, good, good), 603, "residual", seen);
    expect(fuse(good, infinite, good), 603, "attention", seen);
    expect(fuse(good, good, nan), 603, "slope", seen);
    // The reference's attention has the ground's size.
    let narrow = HeadMap::new(Samples::F32(&values[..9]), 1, ImageSize::new(3, 3).unwrap());
    let reference = ReferenceFusion::new(1.65, 200.0, range).unwrap().vanilla(
        &coefficients,
        &good,
        &narrow.unwrap(),
        &mut vec![0.0; reference_scratch_len(size, 4, 4, 0)],
        &mut [0.0; 12],
    );
    expect(reference, 609, "3x3, must be 4x3", seen);

    let expected = [
        101..=108,
        201..=205,
        301..=302,
        401..=404,
        501..=504,
        601..=609,
        701..=702,
    ];
    let expected: Vec<u16> = expected.into_iter().flatten().collect();
    assert_eq!(all.into_keys().collect::<Vec<_>>(), expected);
}
