//! The ground in every pose, against an oracle that intersects rays and planes in the world.
#![allow(clippy::unwrap_used)]

use std::f64::consts::PI;

use gedepth_core::camera::{
    BrownConrady, CameraModel, ImageSize, Intrinsics, KannalaBrandt, Pinhole, Pixel,
};
use gedepth_core::table::{Coverage, GroundCoefficients, GroundView, MIN_INVERSE_DEPTH};
use gedepth_core::{
    Angle, CameraFrame, Direction, Error, Extrinsics, Ground, GroundPlane, Mounting, Point,
    WorldFrame,
};
use proptest::prelude::*;

type Matrix = [[f64; 3]; 3];

fn product(a: Matrix, b: Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

fn apply(a: Matrix, p: [f64; 3]) -> [f64; 3] {
    a.map(|row| row.iter().zip(p).map(|(a, b)| a * b).sum())
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// By cofactors.
fn inverse(m: Matrix) -> Matrix {
    let c = |i: usize, j: usize| {
        let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let determinant = (0..3).map(|j| m[0][j] * c(0, j)).sum::<f64>();
    std::array::from_fn(|i| std::array::from_fn(|j| c(j, i) / determinant))
}

/// Any rotation, from three angles.
fn rotation([a, b, c]: [f64; 3]) -> Matrix {
    let x = [
        [1.0, 0.0, 0.0],
        [0.0, a.cos(), -a.sin()],
        [0.0, a.sin(), a.cos()],
    ];
    let y = [
        [b.cos(), 0.0, b.sin()],
        [0.0, 1.0, 0.0],
        [-b.sin(), 0.0, b.cos()],
    ];
    let z = [
        [c.cos(), -c.sin(), 0.0],
        [c.sin(), c.cos(), 0.0],
        [0.0, 0.0, 1.0],
    ];
    product(product(x, y), z)
}

/// The paper's Eq. 5 for the plane n . p = d: 1 / z_c = n . A [u v 1] / (d - n . B), A = (K R)^-1, B = -R^-1 T.
fn equation_5(k: Matrix, r: Matrix, t: [f64; 3], n: [f64; 3], d: f64, u: f64, v: f64) -> f64 {
    let a = apply(inverse(product(k, r)), [u, v, 1.0]);
    let b = apply(inverse(r), t).map(|c| -c);
    dot(n, a) / (d - dot(n, b))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1024, failure_persistence: None, ..ProptestConfig::default() })]

    /// Cameras that are rolled, look up, down, sideways and backwards; planes and worlds of every orientation.
    #[test]
    fn inverse_depth_is_equation_5(
        angles in prop::array::uniform3(-PI..PI), tilt in prop::array::uniform3(-PI..PI),
        position in prop::array::uniform3(-50.0..50.0), height in 0.05..20.0_f64,
        focal in 100.0..3000.0, skew in -3.0..3.0, u in 0.0..1279.0, v in 0.0..719.0,
    ) {
        let k = [[focal, skew, 640.3], [0.0, focal * 1.01, 358.1], [0.0, 0.0, 1.0]];
        let r = rotation(angles);
        let up = apply(rotation(tilt), [0.0, 0.0, 1.0]);
        // The plane lies `height` under the camera.
        let offset = dot(up, position) - height;
        let t = apply(r, position).map(|c| -c);
        let expected = equation_5(k, r, t, up, offset, u, v);

        let extrinsics = Extrinsics::world_to_camera(r, t).unwrap();
        let plane = GroundPlane::new(Direction::new(up[0], up[1], up[2]).unwrap(), offset).unwrap();
        let ground = Ground::seen_by(&extrinsics, &plane).unwrap();
        prop_assert!((ground.height() - height).abs() < 1e-9 * (1.0 + dot(position, position).sqrt()));

        let intrinsics = Intrinsics::from_matrix(ImageSize::new(1280, 720).unwrap(), k).unwrap();
        let camera = Pinhole::new(intrinsics);
        let point = camera.forward_ray(Pixel::new(u, v)).unwrap();
        let tolerance = 1e-11 / height + 1e-9 * expected.abs();
        prop_assert!((ground.inverse_depth(point) - expected).abs() < tolerance);
        let coefficients = GroundCoefficients::new(&intrinsics, &ground);
        prop_assert!((coefficients.inverse_depth(u, v) - expected).abs() < tolerance);

        // And the point at that depth lies on the plane in the world.
        if expected > 1e-4 {
            let z = 1.0 / expected;
            let world = extrinsics.to_world(Point::new(point.x * z, point.y * z, z));
            prop_assert!(plane.height_of(world).abs() < 1e-7 * (1.0 + z));
            let back = extrinsics.to_camera(world).vector();
            prop_assert!((back.z - z).abs() < 1e-9 * (1.0 + z));
        }
    }

    /// The end points of the vanishing line lie on it and on the frame, for lenses of all kinds.
    #[test]
    fn vanishing_line_ends(
        pitch in -90.0..90.0, roll in -180.0..180.0, lens in 0..3, focal in 60.0..800.0,
    ) {
        let size = ImageSize::new(320, 200).unwrap();
        let k = Intrinsics::centred(size, focal).unwrap();
        let pinhole = Pinhole::new(k);
        let brown = BrownConrady::new(k, [-0.1, 0.01, 1e-4, 1e-4, 0.0]).unwrap();
        let fisheye = KannalaBrandt::new(k, [-0.02, 0.002, 0.0, 0.0]).unwrap();
        let camera: &dyn CameraModel = match lens { 0 => &pinhole, 1 => &brown, _ => &fisheye };
        let ground = Ground::from_mounting(1.5, Angle::from_degrees(pitch), Angle::from_degrees(roll)).unwrap();
        let down = ground.down().vector();
        // Does any row or column of the picture's frame have both ground and sky?
        let dip = |u: u32, v: u32| camera.unproject(Pixel::new(f64::from(u), f64::from(v))).map(|r| r.vector().dot(down));
        let frame: Vec<f64> = (0..320).flat_map(|u| [dip(u, 0), dip(u, 199)])
            .chain((0..200).flat_map(|v| [dip(0, v), dip(319, v)])).flatten().collect();
        let mixed = frame.iter().any(|d| *d > 0.0) && frame.iter().any(|d| *d <= 0.0);
        let line = ground.vanishing_line(camera);
        if frame.len() == 1040 && lens == 0 {
            prop_assert_eq!(line.is_some(), mixed);
        }
        if let Some([a, b]) = line {
            prop_assert!((a.u, a.v) <= (b.u, b.v));
            for end in [a, b] {
                // On the line: at the edge of a field of view just inside it, for want of a ray on it.
                let towards = |c: f64, middle: f64| middle + (c - middle) * (1.0 - 1e-9);
                let ray = camera.unproject(Pixel::new(towards(end.u, 159.5), towards(end.v, 99.5)));
                prop_assert!(ray.unwrap().vector().dot(down).abs() < 1e-6);
                let on_frame = [(end.u, 319.0), (end.v, 199.0)].iter()
                    .any(|(c, last)| c.abs() < 1e-9 || (c - last).abs() < 1e-9);
                let at_edge = ray.unwrap().vector().z.acos() > camera.field_of_view().radians() - 1e-4;
                prop_assert!(on_frame || at_edge);
            }
        } else if lens == 0 {
            prop_assert!(!mixed);
        }
    }
}

fn degrees(pitch: f64, roll: f64, yaw: f64) -> Mounting {
    Mounting {
        height: 1.5,
        pitch: Angle::from_degrees(pitch),
        roll: Angle::from_degrees(roll),
        yaw: Angle::from_degrees(yaw),
    }
}

/// The signs of mounting angles, by where known points of the vehicle's frame (x forward, y left, z up) land.
#[test]
fn mounting_signs() {
    let seen = |mounting: &Mounting, x: f64, y: f64, z: f64| {
        let extrinsics = Extrinsics::from_mounting(mounting).unwrap();
        extrinsics.to_camera(Point::new(x, y, z)).vector()
    };
    let close = |a: glam::DVec3, b: [f64; 3]| (a - glam::DVec3::from_array(b)).length() < 1e-12;
    // Ahead at camera height, 2 m left and 0.5 m up: left is -x, up is -y in the picture.
    assert!(close(
        seen(&degrees(0.0, 0.0, 0.0), 10.0, 2.0, 2.0),
        [-2.0, -0.5, 10.0]
    ));
    // Pitched 90 degrees down, the road below is ahead.
    assert!(close(
        seen(&degrees(90.0, 0.0, 0.0), 0.0, 0.0, 0.0),
        [0.0, 0.0, 1.5]
    ));
    // Turned 90 degrees left, what is left is ahead.
    assert!(close(
        seen(&degrees(0.0, 0.0, 90.0), 0.0, 7.0, 1.5),
        [0.0, 0.0, 7.0]
    ));
    // Rolled 90 degrees, the right side is below: the road is to the camera's right.
    assert!(close(
        seen(&degrees(0.0, 90.0, 0.0), 0.0, 0.0, 0.0),
        [1.5, 0.0, 0.0]
    ));
    // The order is yaw, pitch, roll: turned left and pitched down, then rolled about the view.
    let all = degrees(30.0, 20.0, 40.0);
    let (p, r, y) = (
        30_f64.to_radians(),
        20_f64.to_radians(),
        40_f64.to_radians(),
    );
    let ahead = [
        p.cos() * y.cos() * 3.0,
        p.cos() * y.sin() * 3.0,
        1.5 - p.sin() * 3.0,
    ];
    assert!(close(
        seen(&all, ahead[0], ahead[1], ahead[2]),
        [0.0, 0.0, 3.0]
    ));
    let ground = Ground::from_mounting(1.5, all.pitch, all.roll).unwrap();
    let down = [p.cos() * r.sin(), p.cos() * r.cos(), p.sin()];
    assert!(close(ground.down().vector(), down));
    let extrinsics = Extrinsics::from_mounting(&all).unwrap();
    let seen = Ground::seen_by(&extrinsics, &GroundPlane::z_up(0.0).unwrap()).unwrap();
    assert!(close(seen.down().vector(), down) && (seen.height() - 1.5).abs() < 1e-12);
    assert!(close(
        extrinsics.camera_position().vector(),
        [0.0, 0.0, 1.5]
    ));
}

/// The paper's y = h in a y-down world, and the same plane of a z-up vehicle.
#[test]
fn worlds_of_both_kinds() {
    let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let y_down = Extrinsics::world_to_camera(identity, [0.0, 0.25, 0.0]).unwrap();
    // The camera is at y = -0.25, the road at y = 1.4.
    let paper = Ground::seen_by(&y_down, &GroundPlane::y_down(1.4).unwrap()).unwrap();
    assert_eq!(paper.down().vector().to_array(), [0.0, 1.0, 0.0]);
    assert!((paper.height() - 1.65).abs() < 1e-15);
    let vehicle = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]];
    let z_up = Extrinsics::world_to_camera(vehicle, [0.0, 0.0, 0.0]).unwrap();
    let lidar = Ground::seen_by(&z_up, &GroundPlane::z_up(-1.65).unwrap()).unwrap();
    assert_eq!(lidar.down().vector().to_array(), [0.0, 1.0, 0.0]);
    assert_eq!(lidar.height(), 1.65);
    assert_eq!(z_up.rotation(), vehicle);
    assert_eq!(y_down.translation(), [0.0, 0.25, 0.0]);
    let plane = GroundPlane::new(Direction::<WorldFrame>::new(0.0, 0.0, 2.0).unwrap(), -1.65);
    assert_eq!(plane.unwrap(), GroundPlane::z_up(-1.65).unwrap());
}

/// A rotation as a file prints it, off by 1e-4, is used as it is: Eq. 5 is met with the file's own numbers.
#[test]
fn rotations_are_not_polished() {
    let mut r = rotation([1.5, 0.2, -0.7]);
    for (i, entry) in r.iter_mut().flatten().enumerate() {
        *entry += [1e-4, -7e-5, 3e-5, 9e-5][i % 4];
    }
    let (t, n) = ([0.1, 1.2, -0.3], [0.0, 0.0, 1.0]);
    let k = [[700.0, 0.0, 600.0], [0.0, 710.0, 180.0], [0.0, 0.0, 1.0]];
    let extrinsics = Extrinsics::world_to_camera(r, t).unwrap();
    let b = extrinsics.camera_position().vector();
    let ground = Ground::seen_by(&extrinsics, &GroundPlane::z_up(b.z - 1.6).unwrap()).unwrap();
    let camera = Intrinsics::from_matrix(ImageSize::new(1200, 360).unwrap(), k).unwrap();
    let coefficients = GroundCoefficients::new(&camera, &ground);
    for (u, v) in [(0.0, 0.0), (1199.0, 0.0), (0.0, 359.0), (1199.0, 359.0)] {
        let expected = equation_5(k, r, t, n, b.z - 1.6, u, v);
        assert!((coefficients.inverse_depth(u, v) - expected).abs() < 1e-13);
    }
}

/// Camera, pitch and roll for pictures that show all ground, none, and half.
#[test]
fn coverage_and_vanishing_line() -> Result<(), Error> {
    let size = ImageSize::new(101, 51)?;
    let camera = Pinhole::new(Intrinsics::centred(size, 50.0)?);
    let look = |pitch: f64, roll: f64| {
        let ground =
            Ground::from_mounting(2.0, Angle::from_degrees(pitch), Angle::from_degrees(roll))?;
        let mut memory = vec![0.0; size.pixels()];
        let table = GroundView::build(&mut memory, &camera, &ground)?;
        let coverage = Coverage::of(&table, &mut [0.0; 101])?;
        Ok::<_, Error>((coverage, ground.vanishing_line(&camera)))
    };
    let (level, line) = look(0.0, 0.0)?;
    // 25 of 51 rows lie below the middle one, which is the line; the lowest is 25 px below it.
    assert_eq!(level.share, 25.0 / 51.0);
    assert!((level.nearest.unwrap() - 2.0 * 50.0 / 25.0).abs() < 1e-5);
    let [left, right] = line.unwrap();
    assert!(left.u.abs() < 1e-9 && (left.v - 25.0).abs() < 1e-9);
    assert!((right.u - 100.0).abs() < 1e-9 && (right.v - 25.0).abs() < 1e-9);

    let (down, line) = look(80.0, 0.0)?;
    assert_eq!((down.share, line), (1.0, None));
    let (up, line) = look(-80.0, 0.0)?;
    assert_eq!((up.share, up.nearest, line), (0.0, None, None));

    // Rolled by 90 degrees, right side down: the ground is on the right, the line upright.
    let (side, line) = look(0.0, 90.0)?;
    assert_eq!(side.share, 50.0 / 101.0);
    let mut ends = line.unwrap();
    ends.sort_by(|a, b| a.v.total_cmp(&b.v));
    let [upper, lower] = ends;
    assert!((upper.u - 50.0).abs() < 1e-9 && upper.v.abs() < 1e-9);
    assert!((lower.u - 50.0).abs() < 1e-9 && (lower.v - 50.0).abs() < 1e-9);

    // What is so far away that it has no depth does not count.
    let far = [MIN_INVERSE_DEPTH, MIN_INVERSE_DEPTH * 1.01];
    let far = GroundView::from_values(&far, ImageSize::new(2, 1)?, 1.0)?;
    assert_eq!(Coverage::of(&far, &mut [0.0; 2])?.share, 0.5);

    // Upside down the ground is above.
    let (turned, _) = look(0.0, 180.0)?;
    assert_eq!(turned.share, 25.0 / 51.0);
    Ok(())
}

/// A line along the picture's border goes from corner to corner, however rounding has it.
#[test]
fn vanishing_line_along_the_border() {
    let size = ImageSize::new(1216, 352).unwrap();
    let (tilt, focal) = (0.1_f64, 720.0);
    let upright = |cy: f64, tilt: f64, roll: f64| {
        let camera = Pinhole::new(Intrinsics::new(size, focal, focal, 607.5, cy).unwrap());
        let (pitch, roll) = (Angle::from_radians(tilt.atan()), Angle::from_degrees(roll));
        let ground = Ground::from_mounting(1.65, pitch, roll).unwrap();
        ground
            .vanishing_line(&camera)
            .map(|[a, b]| [[a.u, a.v], [b.u, b.v]])
    };
    let near = |line: Option<[[f64; 2]; 2]>, truth: [[f64; 2]; 2]| {
        let line = line.unwrap();
        for (end, truth) in line.as_flattened().iter().zip(truth.as_flattened()) {
            assert!((end - truth).abs() < 1e-6, "{line:?}");
        }
    };
    near(upright(72.0, tilt, 0.0), [[0.0, 0.0], [1215.0, 0.0]]);
    near(
        upright(351.0 - 72.0, -tilt, 0.0),
        [[0.0, 351.0], [1215.0, 351.0]],
    );
    near(upright(72.0, -tilt, 180.0), [[0.0, 0.0], [1215.0, 0.0]]);
    // On its side: columns.
    let size = ImageSize::new(401, 301).unwrap();
    for (roll, cx, left) in [(90.0, 72.0, 0.0), (-90.0, 400.0 - 72.0, 400.0)] {
        let camera = Pinhole::new(Intrinsics::new(size, focal, focal, cx, 150.0).unwrap());
        let pitch = Angle::from_radians(tilt.atan());
        let ground = Ground::from_mounting(1.65, pitch, Angle::from_degrees(roll)).unwrap();
        let [a, b] = ground.vanishing_line(&camera).unwrap();
        assert!(
            (a.u - left).abs() < 1e-6 && (b.u - left).abs() < 1e-6,
            "{a:?}, {b:?}"
        );
        assert!(((a.v - b.v).abs() - 300.0).abs() < 1e-6, "{a:?}, {b:?}");
    }
}

/// The least and the greatest height are heights in every pose.
#[test]
fn heights_at_their_bounds() {
    for height in [1e-3, 1e5] {
        for degrees in -89..=89 {
            let (pitch, roll) = (f64::from(degrees), f64::from(degrees) * 1.7);
            let ground = Ground::from_mounting(
                height,
                Angle::from_degrees(pitch),
                Angle::from_degrees(roll),
            );
            assert_eq!(
                ground.map(|ground| ground.height()),
                Ok(height),
                "{degrees} degrees"
            );
        }
    }
}

/// A fisheye whose image circle lies inside the picture: the line ends on the circle.
#[test]
fn vanishing_line_inside_an_image_circle() -> Result<(), Error> {
    let size = ImageSize::new(1001, 1001)?;
    let k = Intrinsics::centred(size, 100.0)?;
    // t (1 - 0.15 t^2): slope 0.01 at t = sqrt(0.99 / 0.45).
    let camera = KannalaBrandt::new(k, [-0.15, 0.0, 0.0, 0.0])?;
    let ground = Ground::from_mounting(1.0, Angle::ZERO, Angle::ZERO)?;
    let [left, right] = ground.vanishing_line(&camera).unwrap();
    let t = (0.99_f64 / 0.45).sqrt();
    let radius = 100.0 * t * (1.0 - 0.15 * t * t);
    assert!((left.u - (500.0 - radius)).abs() < 1e-3 && (left.v - 500.0).abs() < 1e-6);
    assert!((right.u - (500.0 + radius)).abs() < 1e-3 && (right.v - 500.0).abs() < 1e-6);
    Ok(())
}

/// The same with the camera turned every way: rays at the circle's angle that run along the ground, by bisection.
#[test]
fn vanishing_line_ends_on_an_image_circle() -> Result<(), Error> {
    let size = ImageSize::new(1001, 1001)?;
    let camera = KannalaBrandt::new(Intrinsics::centred(size, 100.0)?, [-0.15, 0.0, 0.0, 0.0])?;
    let t = (0.99_f64 / 0.45).sqrt();
    let radius = 100.0 * t * (1.0 - 0.15 * t * t);
    for (pitch, roll) in [(20.0, 0.0), (-35.0, 10.0), (50.0, 75.0), (10.0, -160.0)] {
        let ground =
            Ground::from_mounting(1.0, Angle::from_degrees(pitch), Angle::from_degrees(roll))?;
        let down = ground.down().vector();
        let dip = |a: f64| (down.x * a.cos() + down.y * a.sin()) * t.sin() + down.z * t.cos();
        let mut ends = vec![];
        for i in 0..1000 {
            let (mut a, mut b) = (f64::from(i) * PI / 500.0, f64::from(i + 1) * PI / 500.0);
            if (dip(a) > 0.0) != (dip(b) > 0.0) {
                for _ in 0..50 {
                    let middle = 0.5 * (a + b);
                    if (dip(a) > 0.0) == (dip(middle) > 0.0) {
                        a = middle;
                    } else {
                        b = middle;
                    }
                }
                ends.push((500.0 + radius * a.cos(), 500.0 + radius * a.sin()));
            }
        }
        ends.sort_by(|a, b| a.partial_cmp(b).unwrap());
        let line = ground.vanishing_line(&camera).unwrap();
        assert_eq!(ends.len(), 2);
        for (end, (u, v)) in line.iter().zip(ends) {
            let off = (end.u - u).hypot(end.v - v);
            assert!(off < 1e-3, "{pitch}, {roll}: {end:?}, not ({u}, {v})");
        }
    }
    Ok(())
}

/// One row, one column, one pixel.
#[test]
fn thin_pictures() -> Result<(), Error> {
    // The line lies 0.16 px above the picture's centre, or to the left of it.
    for (width, height, roll, share) in [
        (1, 1, 10.0, 1.0),
        (9, 1, 0.0, 1.0),
        (1, 9, 0.0, 5.0 / 9.0),
        (9, 1, 90.0, 5.0 / 9.0),
    ] {
        let size = ImageSize::new(width, height)?;
        let camera = Pinhole::new(Intrinsics::centred(size, 9.0)?);
        let ground =
            Ground::from_mounting(1.0, Angle::from_degrees(1.0), Angle::from_degrees(roll))?;
        assert_eq!(ground.vanishing_line(&camera), None, "{width}x{height}");
        let mut memory = vec![0.0; size.pixels()];
        let table = GroundView::build(&mut memory, &camera, &ground)?;
        let coverage = Coverage::of(&table, &mut [0.0; 9])?;
        assert_eq!(coverage.share, share, "{width}x{height}");
    }
    let direction: Direction<CameraFrame> = Direction::new(0.0, 1.0, 0.0)?;
    assert_eq!(Ground::new(direction, 1.5)?.height(), 1.5);
    Ok(())
}
