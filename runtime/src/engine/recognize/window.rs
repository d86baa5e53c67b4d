//! Windows of convolutions and pools; padding; resizing.

use tract_onnx::pb::NodeProto;

use super::Found;
use super::graph::{Reader, attribute, input, integer, sizes, text};
use crate::engine::layer::{
    Coordinates, DepthToSpace, Fill, Nearest, Pad, Padding, Resize, Target, Window,
};

/// That a window reaches over, that are added on one side, or that a side is resized to.
const MOST_PIXELS: usize = 16384;

/// A window that moves over an input, of which each place sees something.
pub(super) fn moving_window(node: &NodeProto, kernel: Option<[usize; 2]>) -> Found<Window> {
    let window = window(node, kernel)?;
    let reach = |axis: usize| (window.kernel[axis] - 1) * window.dilations[axis] + 1;
    // A layer that would only look at padding is for tract; refused later, it would take all others there.
    if let Padding::Explicit(pads) = &window.padding
        && [0, 1].iter().any(|&axis| pads[axis] >= reach(axis))
    {
        return Err("it pads by as much as it reaches over".into());
    }
    Ok(window)
}

pub(super) fn depth_to_space(node: &NodeProto) -> Found<DepthToSpace> {
    let block = integer(node, "blocksize", 0);
    let pixels_together = match text(node, "mode", "DCR") {
        Some("DCR") => true,
        Some("CRD") => false,
        _ => return Err("its mode is neither DCR nor CRD".into()),
    };
    match usize::try_from(block) {
        Ok(block @ 1..=64) => Ok(DepthToSpace {
            block,
            pixels_together,
        }),
        _ => Err(format!("its blocksize is {block}, not 1 to 64").into()),
    }
}

/// The window of a pool.
pub(super) fn pool(node: &NodeProto) -> Found<Window> {
    if integer(node, "storage_order", 0) != 0 {
        return Err("its storage_order is not the usual one".into());
    }
    if node.output.len() != 1 {
        return Err("its second output is read".into());
    }
    let ceil = integer(node, "ceil_mode", 0) != 0;
    Ok(Window {
        ceil,
        ..moving_window(node, None)?
    })
}

/// The window of a convolution, whose weights say its size, or of a pool.
pub(super) fn window(node: &NodeProto, kernel: Option<[usize; 2]>) -> Found<Window> {
    let stated = sizes(node, "kernel_shape", [0; 2]).ok_or("its kernel is not two-dimensional")?;
    let kernel = match kernel {
        Some(kernel) if attribute(node, "kernel_shape").is_none() || stated == kernel => kernel,
        Some(_) => return Err("its kernel_shape is not that of its weights".into()),
        None => stated,
    };
    let strides = sizes(node, "strides", [1; 2]).ok_or("its strides are not two numbers")?;
    let dilations = sizes(node, "dilations", [1; 2]).ok_or("its dilations are not two numbers")?;
    let padding = match text(node, "auto_pad", "NOTSET") {
        Some("NOTSET" | "") => Padding::Explicit(
            sizes(node, "pads", [0; 4]).ok_or("its padding is not four numbers, none negative")?,
        ),
        Some("VALID") => Padding::Explicit([0; 4]),
        Some("SAME_UPPER") => Padding::Same(false),
        Some("SAME_LOWER") => Padding::Same(true),
        _ => return Err("its auto_pad is unknown".into()),
    };
    let numbers = [kernel, strides, dilations];
    if !numbers.iter().flatten().all(|n| (1..=1024).contains(n)) {
        return Err("its kernel, strides or dilations are not from 1 to 1024".into());
    }
    // Geometry is computed in bytes: with these, no number of it comes near usize's end.
    let reaches = [0, 1].map(|axis| (kernel[axis] - 1) * dilations[axis] + 1);
    let pads = match &padding {
        Padding::Explicit(pads) => pads.as_slice(),
        Padding::Same(_) => &[],
    };
    if reaches
        .iter()
        .chain(pads)
        .any(|&pixels| pixels > MOST_PIXELS)
    {
        return Err(format!("it pads or reaches over more than {MOST_PIXELS} pixels").into());
    }
    Ok(Window {
        kernel,
        strides,
        dilations,
        padding,
        ceil: false,
    })
}

impl Reader<'_> {
    pub(super) fn pad(&self, node: &NodeProto, nodes: &mut Vec<usize>) -> Found<Pad> {
        nodes.extend(self.makers(node.input.iter().skip(1)));
        if input(node, 3).is_some() {
            return Err("it pads along axes given as an input".into());
        }
        let pads = match attribute(node, "pads") {
            Some(pads) => pads.ints.clone(),
            None => {
                let name = input(node, 1).ok_or("it has no pads")?;
                self.integers(name).ok_or("its pads are not constant")?.0
            }
        };
        let &[0, 0, top, left, 0, 0, bottom, right] = &pads[..] else {
            return Err(format!("it pads {pads:?}, not height and width alone").into());
        };
        let fill = match text(node, "mode", "constant") {
            Some("constant") => Fill::Constant(match input(node, 2) {
                Some(value) => *self
                    .real_constant(value, nodes)
                    .ok_or("its padding's value is not constant")??
                    .values
                    .first()
                    .ok_or("its padding's value is empty")?,
                None => super::graph::float(node, "value", 0.0),
            }),
            Some("edge") => Fill::Edge,
            Some("reflect") => Fill::Reflect,
            _ => return Err("its mode of padding is unknown".into()),
        };
        if pads
            .iter()
            .any(|pad| pad.unsigned_abs() > MOST_PIXELS as u64)
        {
            return Err(format!("it pads by more than {MOST_PIXELS}").into());
        }
        Ok(Pad {
            before: [top, left],
            after: [bottom, right],
            apart: [1; 2],
            fill,
        })
    }

    pub(super) fn resize(&self, node: &NodeProto, nodes: &mut Vec<usize>) -> Found<Resize> {
        nodes.extend(self.makers(node.input.iter().skip(1)));
        let linear = match text(node, "mode", "nearest") {
            Some("nearest") => false,
            Some("linear") => true,
            _ => return Err("its mode is neither nearest nor linear".into()),
        };
        let coordinates = match text(node, "coordinate_transformation_mode", "half_pixel") {
            Some("half_pixel") => Coordinates::HalfPixel,
            Some("pytorch_half_pixel") => Coordinates::PytorchHalfPixel,
            Some("asymmetric") => Coordinates::Asymmetric,
            Some("align_corners") => Coordinates::AlignCorners,
            _ => return Err("its coordinate_transformation_mode is not supported".into()),
        };
        let nearest = match text(node, "nearest_mode", "round_prefer_floor") {
            Some("round_prefer_floor") => Nearest::RoundPreferFloor,
            Some("round_prefer_ceil") => Nearest::RoundPreferCeil,
            Some("floor") => Nearest::Floor,
            Some("ceil") => Nearest::Ceil,
            _ => return Err("its nearest_mode is unknown".into()),
        };
        let other = ["antialias", "exclude_outside", "axes"];
        let given =
            |name: &&str| attribute(node, name).is_some_and(|a| a.i != 0 || !a.ints.is_empty());
        if let Some(name) = other.iter().find(|name| given(name)) {
            return Err(format!("its {name} is not supported").into());
        }
        if text(node, "keep_aspect_ratio_policy", "stretch") != Some("stretch") {
            return Err("its keep_aspect_ratio_policy is not supported".into());
        }
        let target = match (input(node, 2), input(node, 3)) {
            (_, Some(sizes)) => {
                match self.integers(sizes).ok_or("its sizes are not constant")?.0[..] {
                    [1, _, height, width]
                        if [height, width]
                            .iter()
                            .all(|side| (1..=MOST_PIXELS as i64).contains(side)) =>
                    {
                        Target::Sizes([height as usize, width as usize])
                    }
                    _ => return Err("its sizes are not [1, channels, height, width]".into()),
                }
            }
            (Some(scales), None) => {
                match self.floats(scales).ok_or("its scales are not constant")?[..] {
                    [1.0, 1.0, height, width]
                        if [height, width]
                            .iter()
                            .all(|scale| (0.01..=100.0).contains(scale)) =>
                    {
                        Target::Scales([height, width])
                    }
                    _ => return Err("its scales are not [1, 1, 0.01 to 100, 0.01 to 100]".into()),
                }
            }
            (None, None) => return Err("it has neither scales nor sizes".into()),
        };
        // With sizes the number of channels is not checked here; the layer keeps it, and tract would too.
        Ok(Resize {
            linear,
            coordinates,
            nearest,
            target,
        })
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use tract_onnx::pb::{AttributeProto, attribute_proto::AttributeType};

    use super::*;

    fn node(attributes: &[(&str, &[i64])]) -> NodeProto {
        let attribute = |(name, ints): &(&str, &[i64])| AttributeProto {
            name: (*name).to_owned(),
            r#type: AttributeType::Ints.into(),
            ints: ints.to_vec(),
            ..AttributeProto::default()
        };
        NodeProto {
            op_type: "Conv".to_owned(),
            attribute: attributes.iter().map(attribute).collect(),
            ..NodeProto::default()
        }
    }

    /// Times a pixel's bytes, padding of 2^59 pixels is 0.
    #[test]
    fn windows_larger_than_any_picture_are_left_to_tract() {
        let sane = node(&[("kernel_shape", &[3, 3]), ("pads", &[1, 1, 1, 16384])]);
        assert!(window(&sane, None).is_ok());
        for wrong in [
            node(&[("kernel_shape", &[1, 1]), ("pads", &[0, 0, 0, 1 << 59])]),
            node(&[("kernel_shape", &[3, 3]), ("pads", &[0, 16385, 0, 0])]),
            node(&[("kernel_shape", &[1024, 1]), ("dilations", &[1024, 1])]),
        ] {
            let reason = window(&wrong, None).unwrap_err();
            assert!(reason.to_string().contains("16384"));
        }
    }
}
