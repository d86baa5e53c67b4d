//! Every form of table against f64, at every pixel, to the horizon.
#![allow(clippy::unwrap_used)]

use gedepth_core::camera::{
    BrownConrady, CameraModel, ImageSize, Intrinsics, KannalaBrandt, Pinhole, Pixel,
};
use gedepth_core::table::{
    FixedLut, FixedView, GroundCoefficients, GroundLut, GroundRows, GroundView, KittiLut,
    MIN_INVERSE_DEPTH, NO_GROUND, RayLut, RayView, RowLut, RowTolerance, RowView,
    depth_from_inverse, write_depth,
};
use gedepth_core::{Angle, CameraFrame, Direction, Error, Ground, Point};
use glam::DVec2;
use proptest::prelude::*;

/// 1e-5 of the depth up to 200 m; farther, and above the line, the same in 1/m.
const TOLERANCE: f64 = 1e-5 / 200.0;

fn ground(height: f64, pitch: f64, roll: f64) -> Ground {
    Ground::from_mounting(
        height,
        Angle::from_degrees(pitch),
        Angle::from_degrees(roll),
    )
    .unwrap()
}

/// The true inverse depths, row-major; `None` where the camera has no forward ray.
fn oracle(camera: &dyn CameraModel, ground: &Ground) -> Vec<Option<f64>> {
    let size = camera.size();
    let down = ground.down().vector();
    let pixels = (0..size.height()).flat_map(|v| (0..size.width()).map(move |u| (u, v)));
    pixels
        .map(|(u, v)| {
            let ray = camera.unproject(Pixel::new(f64::from(u), f64::from(v)))?;
            let r = ray.vector();
            (r.z > 1e-6).then(|| down.dot(r) / (r.z * ground.height()))
        })
        .collect()
}

fn rows(table: &dyn GroundRows) -> Vec<f32> {
    let size = table.size();
    let mut values = vec![0.0; size.pixels()];
    for (v, row) in (0..).zip(values.chunks_exact_mut(size.width() as usize)) {
        table.write_row(v, row).unwrap();
        assert!(row.iter().all(|value| *value <= table.row_bound(v)));
    }
    values
}

fn agrees(
    values: &[f32],
    oracle: &[Option<f64>],
    tolerance: impl Fn(f64) -> f64,
) -> Result<(), TestCaseError> {
    for (index, (value, truth)) in values.iter().zip(oracle).enumerate() {
        match truth {
            Some(truth) => {
                let error = (f64::from(*value) - truth).abs();
                prop_assert!(
                    error <= tolerance(*truth),
                    "pixel {}: {} instead of {}",
                    index,
                    value,
                    truth
                );
                if *truth <= 0.0 {
                    prop_assert_eq!(depth_from_inverse(*value), 0.0);
                }
            }
            None => prop_assert_eq!(*value, NO_GROUND),
        }
    }
    Ok(())
}

/// f32 rounding of a value, and 1e-5 of the depth up to 200 m.
fn exact(truth: f64) -> f64 {
    (truth.abs() * 1e-5).max(TOLERANCE)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn pinhole_table(
        focal in 60.0..3000.0, cx in 0.0..119.0, cy in 0.0..79.0, height in 1.0..4.0,
        pitch in -90.0..90.0, roll in -180.0..180.0, width in 1_u32..120,
    ) {
        let size = ImageSize::new(width, 40).unwrap();
        let intrinsics = Intrinsics::new(size, focal, focal, cx, cy).unwrap();
        let camera = Pinhole::new(intrinsics);
        let ground = ground(height, pitch, roll);
        let truth = oracle(&camera, &ground);
        let mut memory = vec![f32::NAN; size.pixels() + 3];
        let view = GroundView::build(&mut memory, &camera, &ground).unwrap();
        agrees(view.values(), &truth, exact)?;
        prop_assert_eq!(rows(&view), view.values());
        // The same rows from three numbers.
        let coefficients = GroundCoefficients::new(&intrinsics, &ground);
        prop_assert_eq!(&rows(&coefficients), view.values());
        // The bound that the documentation states.
        let [_, per_column, _] = coefficients.coefficients();
        let bound = |t: f64| (t.abs() + 16.0 * per_column.abs()) * 2_f64.powi(-23);
        agrees(view.values(), &truth, bound)?;
    }

    #[test]
    fn distorted_tables_and_kept_rays(
        focal in 15.0..200.0, height in 1.5..3.0, pitch in -30.0..30.0, roll in -10.0..10.0, fisheye in any::<bool>(),
    ) {
        let size = ImageSize::new(64, 48).unwrap();
        let k = Intrinsics::centred(size, focal).unwrap();
        let brown = BrownConrady::new(k, [-0.3, 0.1, 1e-3, -1e-3, -0.02]).unwrap();
        let kannala = KannalaBrandt::new(k, [0.05, -0.01, 0.002, 0.0]).unwrap();
        let camera: &dyn CameraModel = if fisheye { &kannala } else { &brown };
        let ground = ground(height, pitch, roll);
        let truth = oracle(camera, &ground);
        let mut memory = vec![0.0; size.pixels()];
        let view = GroundView::build(&mut memory, camera, &ground).unwrap();
        agrees(view.values(), &truth, |t| t.abs() * 1e-7 + 1e-12)?;
        // Rays kept from this camera, for this and any other ground.
        let mut ray_memory = vec![0.0; RayView::len(size)];
        let rays = RayView::build(&mut ray_memory, camera).unwrap();
        prop_assert_eq!(rays.size(), size);
        let mut again = vec![0.0; size.pixels()];
        let view = GroundView::rebuild(&mut again, &rays, &ground).unwrap();
        let down = ground.down().vector();
        for (index, (value, truth)) in view.values().iter().zip(&truth).enumerate() {
            let Some(truth) = truth else {
                prop_assert_eq!(*value, NO_GROUND);
                continue;
            };
            let (u, v) = (index % 64, index / 64);
            let p = camera.forward_ray(Pixel::new(u as f64, v as f64)).unwrap();
            let size = (down.x * p.x).abs() + (down.y * p.y).abs() + down.z.abs();
            let bound = size / ground.height() * 5.01 * 2_f64.powi(-24);
            prop_assert!((f64::from(*value) - truth).abs() <= bound, "{} instead of {}", value, truth);
        }
        prop_assert_eq!(view.camera_height(), ground.height() as f32);
    }

    #[test]
    fn fixed_point_within_one_step(
        focal in 40.0..500.0, height in 1.0..4.0, pitch in -20.0..20.0, roll in -20.0..20.0, distorted in any::<bool>(),
    ) {
        let size = ImageSize::new(50, 60).unwrap();
        let k = Intrinsics::centred(size, focal).unwrap();
        let (pinhole, fisheye) = (Pinhole::new(k), KannalaBrandt::new(k, [0.01, 0.0, 0.0, 0.0]).unwrap());
        let camera: &dyn CameraModel = if distorted { &fisheye } else { &pinhole };
        let ground = ground(height, pitch, roll);
        let mut kitti = vec![0; size.pixels()];
        let kitti = FixedView::<256, 255>::build(&mut kitti, camera, &ground).unwrap();
        let mut coarse = vec![0; size.pixels()];
        let coarse = FixedView::<10, 50>::build(&mut coarse, camera, &ground).unwrap();
        for ((fine, coarse), truth) in kitti.values().iter().zip(coarse.values()).zip(oracle(camera, &ground)) {
            for (steps, per_metre, range) in [(fine, 256.0, 255.0), (coarse, 10.0, 50.0)] {
                let depth = truth.filter(|t| *t >= 1.0 / range).map(|t| 1.0 / t);
                match depth {
                    Some(depth) => {
                        prop_assert!((f64::from(*steps) / per_metre - depth).abs() <= 0.5000001 / per_metre);
                        prop_assert!(*steps > 0);
                    }
                    None => prop_assert_eq!(*steps, 0),
                }
            }
        }
        for (inverse, steps) in rows(&kitti).into_iter().zip(kitti.values()) {
            let expected = if *steps == 0 { NO_GROUND } else { 256.0 / f32::from(*steps) };
            prop_assert_eq!(inverse, expected);
        }
        prop_assert_eq!(kitti.camera_height(), height as f32);
    }

    /// One value a row: as coarse as was allowed and no coarser.
    #[test]
    fn rows_where_roll_allows(roll in -2.0..2.0, pitch in -10.0..10.0, height in 1.0..3.0) {
        let size = ImageSize::new(161, 90).unwrap();
        let intrinsics = Intrinsics::centred(size, 120.0).unwrap();
        let ground = ground(height, pitch, roll);
        let coefficients = GroundCoefficients::new(&intrinsics, &ground);
        let tolerance = RowTolerance { relative_error: 0.02, up_to: 80.0 };
        // Of a pixel at 80 m whose row's inverse depth is too small by as much as any is.
        let worst = oracle(&Pinhole::new(intrinsics), &ground).chunks_exact(161)
            .map(|row| (row[0].unwrap() - row[80].unwrap()).abs())
            .map(|less| 1.0 / (1.0 / 80.0 - less).max(0.0) / 80.0 - 1.0)
            .fold(0.0, f64::max);
        let mut memory = [0.0; 90];
        match RowView::build(&mut memory, &coefficients, tolerance) {
            Ok(view) => {
                prop_assert!(worst <= 0.02 + 1e-9);
                for (value, row) in view.values().iter().zip(oracle(&Pinhole::new(intrinsics), &ground).chunks_exact(161)) {
                    prop_assert!((f64::from(*value) - row[80].unwrap()).abs() < 1e-7);
                }
                for (row, value) in rows(&view).chunks_exact(161).zip(view.values()) {
                    prop_assert!(row.iter().all(|v| v == value));
                }
                prop_assert_eq!(view.camera_height(), height as f32);
            }
            Err(Error::RollTooLarge { relative_error }) => {
                prop_assert!(worst > 0.02 - 1e-9);
                prop_assert!((relative_error - worst).abs() <= 1e-6 * worst || relative_error == worst);
            }
            Err(other) => prop_assert!(false, "{}", other),
        }
    }
}

/// A tolerance that is none allows no roll; without any roll, all distances are well.
#[test]
fn tolerances_that_are_none() {
    let size = ImageSize::new(161, 90).unwrap();
    let intrinsics = Intrinsics::centred(size, 120.0).unwrap();
    let build = |roll: f64, relative_error, up_to| {
        let ground = ground(1.5, 0.0, roll);
        let coefficients = GroundCoefficients::new(&intrinsics, &ground);
        let tolerance = RowTolerance {
            relative_error,
            up_to,
        };
        RowView::build(&mut [0.0; 90], &coefficients, tolerance).map(|_| ())
    };
    for (relative_error, up_to) in [
        (0.01, -80.0),
        (f64::NAN, 80.0),
        (0.01, f64::NAN),
        (-1.0, 80.0),
        (0.01, f64::INFINITY),
    ] {
        let refused = build(20.0, relative_error, up_to);
        assert!(matches!(refused, Err(Error::RollTooLarge { .. })));
    }
    assert_eq!(build(0.0, 0.01, f64::INFINITY), Ok(()));
}

/// On the vanishing line itself the depth is exactly 0, next to it 1 / value.
#[test]
fn the_line_is_exactly_zero() {
    for height in [0.3, 1.65, 2.5] {
        let size = ImageSize::new(1241, 376).unwrap();
        let camera =
            Pinhole::new(Intrinsics::new(size, 718.856, 718.856, 607.1928, 185.0).unwrap());
        let mut memory = vec![0.0; size.pixels()];
        let table = GroundView::build(&mut memory, &camera, &ground(height, 0.0, 0.0)).unwrap();
        for u in 0..1241 {
            assert_eq!(table.depth(u, 184), Some(0.0));
            assert_eq!(table.depth(u, 185), Some(0.0));
            let below = f64::from(table.depth(u, 186).unwrap());
            assert!((below - height * 718.856).abs() < below * 1e-4, "{below}");
            assert!(table.inverse_depth(u, 184).unwrap() < 0.0);
        }
    }
    assert_eq!(depth_from_inverse(MIN_INVERSE_DEPTH), 0.0);
    assert_eq!(depth_from_inverse(NO_GROUND), 0.0);
    assert_eq!(depth_from_inverse(f32::NAN), 0.0);
    assert_eq!(depth_from_inverse(0.25), 4.0);
}

/// Tables that live in a `static`, are built, rebuilt and read again.
#[test]
fn owned_tables() -> Result<(), Error> {
    static EMPTY: GroundLut<12> = GroundLut::new();
    assert_eq!(EMPTY.view().err(), Some(Error::TableNotBuilt));
    static RAYS: RayLut<12> = RayLut::new();
    assert_eq!(RAYS.view().err(), Some(Error::TableNotBuilt));
    static ROWS: RowLut<3> = RowLut::new();
    assert_eq!(ROWS.view().err(), Some(Error::TableNotBuilt));
    static FIXED: KittiLut<12> = FixedLut::new();
    assert_eq!(FIXED.view().err(), Some(Error::TableNotBuilt));
    const LENGTH: usize = match ImageSize::new(4, 3) {
        Ok(size) => {
            GroundView::len(size)
                + RayView::len(size)
                + RowView::len(size)
                + FixedView::<256, 255>::len(size)
        }
        Err(_) => 0,
    };
    assert_eq!(LENGTH, 12 + 24 + 3 + 12);

    let size = ImageSize::new(4, 3)?;
    let k = Intrinsics::centred(size, 2.0)?;
    let fisheye = KannalaBrandt::new(k, [0.0; 4])?;
    let (low, high) = (ground(1.0, 0.0, 0.0), ground(2.0, 5.0, 0.0));
    let mut lut = EMPTY.clone();
    let built = lut.build(&fisheye, &low)?.values().to_vec();
    assert_eq!(lut.view()?.values(), built);
    let mut rays = RayLut::<20>::default();
    rays.build(&fisheye)?;
    let mut direct = GroundLut::<12>::default();
    let direct = direct.build(&fisheye, &high)?;
    let rebuilt = lut.rebuild(&rays.view()?, &high)?;
    for (a, b) in rebuilt.values().iter().zip(direct.values()) {
        assert!((a - b).abs() < 1e-6);
    }
    assert_eq!(lut.view()?.camera_height(), 2.0);
    assert_eq!(lut.view()?.size(), size);

    let pinhole = Pinhole::new(k);
    let mut rows = RowLut::<5>::default();
    let tolerance = RowTolerance {
        relative_error: 0.0,
        up_to: 100.0,
    };
    let coefficients = GroundCoefficients::new(&k, &low);
    rows.build(&coefficients, tolerance)?;
    let kept = rows.view()?;
    assert_eq!(kept.values(), [-0.5, 0.0, 0.5]);
    assert_eq!((kept.size(), kept.camera_height()), (size, 1.0));
    let mut fixed = KittiLut::<12>::default();
    fixed.build(&pinhole, &low)?;
    assert_eq!(
        fixed.view()?.values(),
        [0, 0, 0, 0, 0, 0, 0, 0, 512, 512, 512, 512]
    );
    assert_eq!(
        (fixed.view()?.size(), fixed.view()?.camera_height()),
        (size, 1.0)
    );
    let higher = GroundCoefficients::new(&k, &high);
    assert_eq!((higher.size(), higher.camera_height()), (size, 2.0));

    // A table kept elsewhere.
    let kept = GroundView::from_values(&built, size, 1.0)?;
    assert_eq!(
        (kept.values(), kept.size(), kept.camera_height()),
        (&built[..], size, 1.0)
    );
    assert_eq!(kept.inverse_depth(4, 0), None);
    assert_eq!(kept.inverse_depth(0, 3), None);
    assert_eq!(kept.inverse_depth(3, 2), built.last().copied());
    Ok(())
}

/// The network's ground channel: metres, nothing beyond the cut.
#[test]
fn ground_channel() -> Result<(), Error> {
    let size = ImageSize::new(2, 5)?;
    let camera = Pinhole::new(Intrinsics::new(size, 100.0, 100.0, 0.5, 1.0)?);
    let mut memory = [0.0; 10];
    let table = GroundView::build(&mut memory, &camera, &ground(1.5, 0.0, 0.0))?;
    let mut metres = [f32::NAN; 10];
    write_depth(&table, 100.0, &mut metres)?;
    for (value, expected) in metres
        .iter()
        .zip([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 75.0, 75.0, 50.0, 50.0])
    {
        assert!((value - expected).abs() < 1e-4, "{metres:?}");
    }
    Ok(())
}

/// Rows are handed out whole or not at all.
#[test]
fn rows_that_are_not_there() -> Result<(), Error> {
    let size = ImageSize::new(4, 3)?;
    let k = Intrinsics::centred(size, 2.0)?;
    let (camera, ground) = (Pinhole::new(k), ground(1.0, 0.0, 0.0));
    let (mut full, mut fixed, mut one) = ([0.0; 12], [0; 12], [0.0; 3]);
    let coefficients = GroundCoefficients::new(&k, &ground);
    let tolerance = RowTolerance {
        relative_error: 0.1,
        up_to: 10.0,
    };
    let sources: [&dyn GroundRows; 4] = [
        &GroundView::build(&mut full, &camera, &ground)?,
        &FixedView::<256, 255>::build(&mut fixed, &camera, &ground)?,
        &RowView::build(&mut one, &coefficients, tolerance)?,
        &coefficients,
    ];
    for source in sources {
        let mut row = [0.0; 5];
        assert_eq!(
            source.write_row(3, &mut row[..4]),
            Err(Error::GroundRow { row: 3 })
        );
        assert_eq!(
            source.write_row(0, &mut row),
            Err(Error::GroundRow { row: 0 })
        );
        assert_eq!(
            source.write_row(0, &mut row[..3]),
            Err(Error::GroundRow { row: 0 })
        );
        assert_eq!(source.write_row(2, &mut row[..4]), Ok(()));
        assert!((row[0] - 0.5).abs() < 1e-6);
    }
    Ok(())
}

/// Rays at 90 degrees and more have no depth; just inside they have, and it stays finite.
#[test]
fn fisheye_beyond_90_degrees() -> Result<(), Error> {
    let size = ImageSize::new(401, 401)?;
    let camera = KannalaBrandt::new(Intrinsics::centred(size, 100.0)?, [0.0; 4])?;
    let ground = ground(1.2, 0.0, 0.0);
    let mut memory = vec![0.0; size.pixels()];
    let table = GroundView::build(&mut memory, &camera, &ground)?;
    // 90 degrees are 157.08 px from the centre.
    assert_eq!(table.inverse_depth(200, 200 + 158), Some(NO_GROUND));
    let near = f64::from(table.inverse_depth(200, 200 + 157).unwrap());
    assert!((near - 1.57_f64.tan() / 1.2).abs() < near * 1e-6);
    assert!(table.values().iter().all(|value| value.is_finite()));
    Ok(())
}

/// A camera model from outside the crate: only what a model must have.
struct Foreign;

impl CameraModel for Foreign {
    fn size(&self) -> ImageSize {
        ImageSize::new(5, 3).unwrap()
    }

    fn field_of_view(&self) -> Angle {
        Angle::from_degrees(90.0)
    }

    fn project(&self, _: Point<CameraFrame>) -> Option<Pixel> {
        None
    }

    /// Column 0 looks ahead, column 1 down and ahead, column 2 sideways, column 3 back; column 4 sees nothing.
    fn unproject(&self, pixel: Pixel) -> Option<Direction<CameraFrame>> {
        let [x, y, z] = match pixel.u as u32 {
            0 => [0.0, 0.0, 1.0],
            1 => [1.0, 2.0, 4.0],
            2 => [1.0, 1.0, 0.0],
            3 => [0.0, 1.0, -1.0],
            _ => return None,
        };
        Direction::new(x, y, z).ok()
    }
}

#[test]
fn foreign_camera_models() -> Result<(), Error> {
    let point = Foreign.forward_ray(Pixel::new(1.0, 0.0)).unwrap();
    assert!((point.x - 0.25).abs() < 1e-15 && (point.y - 0.5).abs() < 1e-15);
    assert_eq!(Foreign.as_pinhole(), None);
    let mut memory = [0.0; 15];
    let table = GroundView::build(&mut memory, &Foreign, &ground(2.0, 0.0, 0.0))?;
    for row in table.values().chunks_exact(5) {
        assert_eq!(row, [0.0, 0.25, NO_GROUND, NO_GROUND, NO_GROUND]);
    }
    Ok(())
}

/// Whatever a foreign model returns, tables hold no NaN.
struct Broken;

impl CameraModel for Broken {
    fn size(&self) -> ImageSize {
        ImageSize::new(2, 1).unwrap()
    }

    fn field_of_view(&self) -> Angle {
        Angle::from_radians(f64::NAN)
    }

    fn project(&self, _: Point<CameraFrame>) -> Option<Pixel> {
        Some(Pixel::new(f64::NAN, f64::NAN))
    }

    fn unproject(&self, _: Pixel) -> Option<Direction<CameraFrame>> {
        None
    }

    fn forward_ray(&self, pixel: Pixel) -> Option<DVec2> {
        Some(DVec2::splat(if pixel.u > 0.0 {
            f64::NAN
        } else {
            f64::INFINITY
        }))
    }
}

#[test]
fn broken_camera_models() -> Result<(), Error> {
    let ground = ground(2.0, 3.0, 0.0);
    let mut memory = [0.0; 2];
    let table = GroundView::build(&mut memory, &Broken, &ground)?;
    assert_eq!(table.values(), [NO_GROUND, NO_GROUND]);
    assert_eq!(ground.vanishing_line(&Broken), None);
    Ok(())
}
