//! `gedepth inspect`: what a model file holds, and who runs which of its nodes.

use std::path::PathBuf;

use clap::Args;
use gedepth::{Engine, Error, Inspection, Model, Place, PlanKind};

/// Prints what a model says about itself, its inputs, outputs and weights, and which of its nodes the quantized engine
/// runs, with which kernel, and why not the others.
#[derive(Args)]
#[command(after_help = super::super::EXIT_CODES)]
pub(crate) struct Arguments {
    /// ONNX file with a gedepth contract [default: the model inside the program]
    model: Option<PathBuf>,
    /// As JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let model = match &arguments.model {
        Some(path) => Model::from_file(path)?,
        None => Model::embedded()?,
    };
    let inspection = model.inspect()?;
    if arguments.json {
        let json = serde_json::to_string_pretty(&inspection).map_err(|e| Error::Write {
            path: "standard output".into(),
            reason: e.to_string(),
        })?;
        say!("{json}")?;
    } else {
        print(&inspection, model.engine())?;
    }
    Ok(())
}

fn print(inspection: &Inspection, engine: Engine) -> Result<(), Error> {
    say!("{:<12}{}", "model", inspection.path.display())?;
    for (entry, value) in &inspection.contract {
        say!("{:<12}{entry} = {value}", "contract")?;
    }
    for (label, tensors) in [
        ("input", &inspection.inputs),
        ("output", &inspection.outputs),
    ] {
        for tensor in tensors {
            say!("{label:<12}{} [{}]", tensor.name, tensor.shape.join(", "))?;
        }
    }
    let weights = inspection.weights;
    say!(
        "{:<12}{} numbers in {} tensors, {:.2} MB",
        "weights",
        weights.numbers,
        weights.tensors,
        weights.bytes as f64 / 1e6
    )?;
    let by = match &inspection.plan {
        PlanKind::Engine => "the engine alone".to_owned(),
        PlanKind::TractWithIslands => "tract, with islands that the engine runs".to_owned(),
        PlanKind::Tract {
            islands_refused: Some(reason),
            ..
        } => format!("tract alone, as the engine cannot plan its part: {reason}"),
        _ => "tract alone".to_owned(),
    };
    let (width, height) = inspection.size;
    say!("{:<12}by {by}, at {width}x{height}", "runs")?;
    if let Engine::Quantized { kernel, threads } = engine {
        say!("{:<12}{kernel:?}, {threads} threads", "engine")?;
    }
    let inside = |node: &&gedepth::InspectedNode| matches!(node.place, Place::Engine { .. });
    let count = inspection.nodes.iter().filter(inside).count();
    say!(
        "{:<12}{count} in the engine, {} in tract",
        "nodes",
        inspection.nodes.len() - count
    )?;
    say!("")?;
    for node in &inspection.nodes {
        let place = match &node.place {
            Place::Engine {
                island,
                layer,
                kernel,
                ..
            } => format!("island {island}  {layer} ({kernel})"),
            Place::Tract { reason, .. } => format!("tract: {reason}"),
            _ => String::new(),
        };
        say!("{:<18} {place:<50} {}", node.operator, node.output)?;
    }
    Ok(())
}
