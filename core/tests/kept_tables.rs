//! Tables and rays that were made earlier and kept, say in flash, read as those just made.
#![allow(clippy::unwrap_used)]

use gedepth_core::camera::{ImageSize, Intrinsics, Pinhole};
use gedepth_core::table::{
    FixedView, GroundCoefficients, GroundRows, GroundView, RayView, RowTolerance, RowView,
};
use gedepth_core::{Angle, Error, Ground};

type Metres<'a> = FixedView<'a, 256, 255>;

#[test]
fn read_as_when_they_were_made() -> Result<(), Error> {
    let size = ImageSize::new(20, 12)?;
    let intrinsics = Intrinsics::centred(size, 15.0)?;
    let camera = Pinhole::new(intrinsics);
    let ground = Ground::from_mounting(1.5, Angle::from_degrees(4.0), Angle::ZERO)?;
    let height = ground.height() as f32;

    let mut values = vec![0.0; GroundView::len(size)];
    let made = GroundView::build(&mut values, &camera, &ground)?;
    assert_eq!(GroundView::from_values(made.values(), size, height)?, made);

    let mut values = vec![0; Metres::len(size)];
    let made = Metres::build(&mut values, &camera, &ground)?;
    assert_eq!(Metres::from_values(made.values(), size, height)?, made);

    let coefficients = GroundCoefficients::new(&intrinsics, &ground);
    let kept = GroundCoefficients::from_values(coefficients.coefficients(), size, height)?;
    assert_eq!(kept, coefficients);

    let mut values = vec![0.0; RowView::len(size)];
    let tolerance = RowTolerance {
        relative_error: 1e-6,
        up_to: 80.0,
    };
    let made = RowView::build(&mut values, &coefficients, tolerance)?;
    assert_eq!(RowView::from_values(made.values(), size, height)?, made);

    let mut values = vec![0.0; RayView::len(size)];
    RayView::build(&mut values, &camera)?;
    let (mut from_made, mut from_kept) = (vec![0.0; size.pixels()], vec![1.0; size.pixels()]);
    let kept = RayView::from_values(&values, size)?;
    GroundView::rebuild(&mut from_kept, &kept, &ground)?;
    let mut again = vec![0.0; RayView::len(size)];
    let made = RayView::build(&mut again, &camera)?;
    GroundView::rebuild(&mut from_made, &made, &ground)?;
    assert_eq!(from_kept, from_made);
    assert_eq!(kept.size(), size);
    Ok(())
}

/// Of exactly the length that the size says, and with a height that is one.
#[test]
fn are_checked() -> Result<(), Error> {
    let size = ImageSize::new(5, 3)?;
    for (len, fits) in [(14, false), (15, true), (16, false)] {
        assert_eq!(
            GroundView::from_values(&vec![0.0; len], size, 1.0).is_ok(),
            fits
        );
        assert_eq!(Metres::from_values(&vec![0; len], size, 1.0).is_ok(), fits);
    }
    for (len, fits) in [(2, false), (3, true), (4, false)] {
        assert_eq!(
            RowView::from_values(&vec![0.0; len], size, 1.0).is_ok(),
            fits
        );
    }
    for (len, fits) in [(14, false), (29, false), (30, true), (31, false)] {
        let values = vec![0.0; len];
        let rays = RayView::from_values(&values, size);
        assert_eq!(rays.is_ok(), fits);
        if !fits {
            let error = rays.unwrap_err();
            assert_eq!(
                error,
                Error::TableLength {
                    needed: 30,
                    given: len
                }
            );
        }
    }
    for height in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let values = [0.0; 15];
        assert!(GroundView::from_values(&values, size, height).is_err());
        assert!(Metres::from_values(&[0; 15], size, height).is_err());
        assert!(RowView::from_values(&values[..3], size, height).is_err());
        let coefficients = GroundCoefficients::from_values([0.0; 3], size, height);
        assert_eq!(coefficients.unwrap_err().code(), 302);
    }
    let height = GroundCoefficients::from_values([0.0; 3], size, 1.5)?.camera_height();
    assert_eq!(height, 1.5);
    Ok(())
}
