"""Latency of the same networks in this engine, stock tract, OpenVINO and ONNX Runtime; prints a Markdown table.

    cargo build --release --bin gedepth
    python3 benches/compare/compare.py [--gedepth PROGRAM] [--rounds N] [--environment FOLDER]

Makes a virtual environment with requirements.txt outside the tree and goes on in it. All engines take turns, a burst of
runs each, so that whatever disturbs the machine disturbs all of them alike.

What is compared: one inference, f32 planes to heads, from Python, for OpenVINO and ONNX Runtime; for this engine and tract
what `gedepth bench` calls `network`. This engine's first layer is quantized during preprocessing, from tables; so the
table has its `preprocess` + `network`, from a picture of 1242x375, in a row of its own. Not compared: ncnn has a format of its
own and no QDQ; rten has no package for Python.
"""

import argparse
import datetime
import os
import pathlib
import platform
import statistics
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
BURST = 40
WARM_UP = 5


def enter_environment(folder):
    """Goes on in the virtual environment; makes it first where it is not there."""
    python = folder / "bin" / "python"
    if pathlib.Path(sys.prefix).resolve() == folder.resolve():
        return
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "-r", HERE / "requirements.txt"], check=True)
    os.execv(python, [python, *sys.argv])


def cpu():
    for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":")[1].strip()
    return platform.processor()


def random_input(size):
    import numpy as np

    return np.random.default_rng(0).uniform(-2, 2.5, (1, 4, size[1], size[0])).astype(np.float32)


def onnx_runtime(path, size, threads):
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    x = random_input(size)
    return in_process(lambda: session.run(None, {"input": x}))


def openvino(path, size, threads):
    import openvino

    core = openvino.Core()
    model = core.read_model(path)
    model.reshape({"input": [1, 4, size[1], size[0]]})
    compiled = core.compile_model(
        model, "CPU", {"INFERENCE_NUM_THREADS": threads, "PERFORMANCE_HINT": "LATENCY", "NUM_STREAMS": 1})
    request = compiled.create_infer_request()
    x = random_input(size)
    return in_process(lambda: request.infer({"input": x}, share_inputs=True, share_outputs=True))


def in_process(infer):
    def burst(runs):
        times = []
        for _ in range(runs + WARM_UP):
            start = time.perf_counter()
            infer()
            times.append((time.perf_counter() - start) * 1e3)
        return {"": times[WARM_UP:]}

    return burst


def gedepth(program, path, size, threads):
    """By the engine on `threads`, or by tract where that is `None`."""
    scene = ROOT / "fixtures/scenes/street"

    def burst(runs):
        output = subprocess.run(
            [program, "bench", scene / "image.png", "--calibration", scene / "calibration.json", "--model", path,
             "--network-size", f"{size[0]}x{size[1]}", "--runs", str(runs + WARM_UP), "--network-output", "--raw",
             *(["--threads", str(threads)] if threads else ["--tract"])], check=True, capture_output=True, text=True).stdout
        times = [[float(t) / 1e3 for t in line.split()] for line in output.splitlines()][WARM_UP:]
        named = {"": [network for _, network, _ in times]}
        if threads:
            named[", with preprocessing"] = [preprocess + network for preprocess, network, _ in times]
        return named

    return burst


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gedepth", default=ROOT / "target/release/gedepth", type=pathlib.Path)
    parser.add_argument("--rounds", default=5, type=int, help=f"bursts of {BURST} runs of each engine")
    parser.add_argument("--environment", default=pathlib.Path.home() / ".cache/gedepth-compare", type=pathlib.Path)
    arguments = parser.parse_args()
    enter_environment(arguments.environment)

    import onnx
    import onnxruntime
    import openvino as openvino_package
    import unet

    shipped = {form: ROOT / f"fixtures/models/adaptive-{form}.onnx" for form in ["int8", "f32"]}
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        metadata = {p.key: p.value for p in onnx.load(shipped["int8"]).metadata_props}
        metadata["gedepth.nominal_size"] = "1216x352"
        multiply_adds = unet.write(folder, (1216, 352), metadata)
        networks = [
            ("shipped adaptive, 640x192", shipped, (640, 192)),
            ("shipped adaptive, 1216x352", shipped, (1216, 352)),
            (f"U-Net of {multiply_adds / 1e9:.1f} GMAC, 1216x352",
             {form: folder / f"unet-{form}.onnx" for form in ["int8", "f32"]}, (1216, 352)),
        ]
        print(f"{cpu()}, {os.cpu_count()} cores, {datetime.date.today()}, OpenVINO {openvino_package.__version__.split('-')[0]}, "
              f"ONNX Runtime {onnxruntime.__version__}; milliseconds, least / median of {arguments.rounds * BURST} (tract: 5)\n")
        print("| network | engine | 1 thread | 2 threads |\n|---|---|---|---|")
        for network, files, size in networks:
            bursts = {}
            for threads in [1, 2]:
                bursts["gedepth int8", threads] = gedepth(arguments.gedepth, files["int8"], size, threads)
                bursts["OpenVINO int8", threads] = openvino(files["int8"], size, threads)
                for form in ["int8", "f32"]:
                    bursts[f"ONNX Runtime {form}", threads] = onnx_runtime(files[form], size, threads)
            # On one thread, as tract is built here; and slow, so few.
            times = {"tract int8": {1: gedepth(arguments.gedepth, files["int8"], size, None)(5)[""]}}
            for _ in range(arguments.rounds):
                for (engine, threads), burst in bursts.items():
                    for name, measured in burst(BURST).items():
                        times.setdefault(engine + name, {}).setdefault(threads, []).extend(measured)
            for engine, by_threads in times.items():
                cells = [f"{min(t):.2f} / {statistics.median(t):.2f}" if (t := by_threads.get(n)) else "" for n in [1, 2]]
                print(f"| {network} | {engine} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
