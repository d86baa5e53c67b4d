#!/usr/bin/env python3
"""Latency of the same networks in this engine, OpenVINO, ONNX Runtime, ncnn, rten and stock tract; prints Markdown.

    cargo build --release --bin gedepth
    benches/compare/compare.py [--rounds N]      # print
    benches/compare/compare.py --readme          # and put it into benches/README.md, and comparison.svg beside it

Makes a virtual environment with requirements.txt outside the tree and goes on in it; builds rten's program (rten/) there. All
engines take turns, a burst of runs each, so that whatever disturbs the machine disturbs all of them alike. An engine that
cannot be had or cannot run a network is named with the reason.

What is compared: one inference, f32 planes to heads; from Python for OpenVINO, ONNX Runtime and ncnn, from Rust for rten; for
this engine and tract what `gedepth bench` calls `network`. This engine's first layer is quantized during preprocessing, from
tables; so the table has its `preprocess` + `network`, from a picture of 1242x375, in a row of its own. ncnn has a format of
its own: pnnx converts the f32 file. It has no QDQ, and its packages have no quantizer, so there is no int8 of it. rten and
tract compute convolutions of QDQ files in f32.
"""

import argparse
import datetime
import functools
import importlib.metadata
import importlib.util
import os
import pathlib
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
sys.dont_write_bytecode = True  # leaves nothing in the tree
import report

PACKAGES = HERE / "requirements.txt"
# Installed without what it depends on: only its Python half needs PyTorch.
PNNX = "pnnx==20261020"
THREADS = [1, 2]
BURST = 40
# Of those that take some ten times as long as the others.
SLOW, SLOW_BURST = ("rten", "tract"), 5
OURS = "gedepth int8"
WITH_PREPROCESSING = ", with preprocessing"


def enter_environment(folder):
    """Goes on in the virtual environment; makes it, or brings it up to date, first."""
    python = folder / "bin/python"
    if pathlib.Path(sys.prefix).resolve() == folder.resolve():
        return
    packages = [line for line in PACKAGES.read_text().split() if line]
    stamp, wanted = folder / "installed.txt", "\n".join([*packages, PNNX])
    if not (stamp.exists() and stamp.read_text() == wanted):
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        # One by one: one that is not to be had here costs its engine, not the others.
        done = [subprocess.run([*pip, package]).returncode == 0 for package in packages]
        done.append(subprocess.run([*pip, "--no-deps", PNNX]).returncode == 0)
        if all(done):
            stamp.write_text(wanted)
    os.execv(python, [python, *sys.argv])


def call(command, **more):
    """What a program prints; its last words where it fails."""
    done = subprocess.run(command, capture_output=True, text=True, **more)
    if done.returncode != 0:
        words = (done.stderr.strip() or done.stdout.strip() or f"exit status {done.returncode}").splitlines()
        raise RuntimeError(words[-1].strip())
    return done.stdout


def random_input(size):
    import numpy as np

    return np.random.default_rng(0).uniform(-2, 2.5, (1, 4, size[1], size[0])).astype(np.float32)


def warm_up(runs):
    return max(runs // 8, 1)


def in_process(infer):
    def burst(runs):
        times = []
        for _ in range(runs + warm_up(runs)):
            start = time.perf_counter()
            infer()
            times.append((time.perf_counter() - start) * 1e3)
        return {"": times[warm_up(runs):]}

    return burst


def onnx_runtime(path, size, threads):
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 3  # no warnings of unused constants
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


def ncnn(path, size, threads, folder):
    import ncnn

    converted = to_ncnn(path, size, folder)
    net = ncnn.Net()
    net.opt.num_threads = threads
    net.opt.use_fp16_packed = net.opt.use_fp16_storage = net.opt.use_fp16_arithmetic = False
    if net.load_param(f"{converted}.param") != 0 or net.load_model(f"{converted}.bin") != 0:
        raise RuntimeError("ncnn does not load what pnnx made")
    x = random_input(size)[0]

    def infer():
        with net.create_extractor() as extractor:
            extractor.input("in0", ncnn.Mat(x))
            for output in ["out0", "out1", "out2"]:
                code, _ = extractor.extract(output)
                if code != 0:
                    raise RuntimeError(f"ncnn: {output}: {code}")

    infer()
    return in_process(infer)


@functools.cache
def to_ncnn(path, size, folder):
    """Converts in a folder of its own, since pnnx writes beside its input; gives the files' name without its end."""
    package = importlib.util.find_spec("pnnx")
    if package is None:
        raise RuntimeError("no package pnnx, which converts to ncnn")
    own = folder / f"ncnn-{path.stem}-{size[0]}"
    own.mkdir()
    shutil.copy(path, own / "network.onnx")
    program = pathlib.Path(package.submodule_search_locations[0]) / "pnnx"
    call([program, "network.onnx", f"inputshape=[1,4,{size[1]},{size[0]}]", "fp16=0"], cwd=own)
    return own / "network.ncnn"


def rten(program, path, size, threads):
    def burst(runs):
        if isinstance(program, Exception):
            raise program
        lines = call([program, path, *map(str, [*size, threads, runs + warm_up(runs)])]).split()
        return {"": [float(line) / 1e3 for line in lines][warm_up(runs):]}

    return burst


def build_rten(environment):
    """The program, or why there is none."""
    target = environment / "rten"
    try:
        call(["cargo", "build", "--release", "--locked", "--manifest-path", HERE / "rten/Cargo.toml"],
             env={**os.environ, "CARGO_TARGET_DIR": str(target)})
    except (RuntimeError, OSError) as error:
        return RuntimeError(f"not built: {error}")
    return target / "release/compare-rten"


def gedepth(program, path, size, threads):
    """By the engine on `threads`, or by tract where that is `None`."""
    scene = report.ROOT / "fixtures/scenes/street"

    def burst(runs):
        output = call(
            [program, "bench", scene / "image.png", "--calibration", scene / "calibration.json", "--model", path,
             "--network-size", f"{size[0]}x{size[1]}", "--runs", str(runs + warm_up(runs)), "--network-output", "--raw",
             *(["--threads", str(threads)] if threads else ["--tract"])])
        times = [[float(t) / 1e3 for t in line.split()] for line in output.splitlines()][warm_up(runs):]
        named = {"": [network for _, network, _ in times]}
        if threads:
            named[WITH_PREPROCESSING] = [preprocess + network for preprocess, network, _ in times]
        return named

    return burst


def engines(arguments, files, size, folder, rten_program):
    """[(name, threads, what makes its burst)]."""
    for threads in THREADS:
        yield OURS, threads, lambda: gedepth(arguments.gedepth, files["int8"], size, threads)
        yield "OpenVINO int8", threads, lambda: openvino(files["int8"], size, threads)
        for form in ["int8", "f32"]:
            yield f"ONNX Runtime {form}", threads, lambda: onnx_runtime(files[form], size, threads)
        yield "ncnn f32", threads, lambda: ncnn(files["f32"], size, threads, folder)
        for form in ["int8", "f32"]:
            yield f"rten {form}", threads, lambda: rten(rten_program, files[form], size, threads)
        if threads == 1:
            # As it is built here.
            yield "tract int8", threads, lambda: gedepth(arguments.gedepth, files["int8"], size, None)


def measure(makers, rounds):
    """Milliseconds {engine: {threads: [...]}}, and {engine: why it did not run}."""
    times, bursts, reasons = {}, {}, {}

    def try_to(engine, do):
        try:
            return do()
        except Exception as error:
            # In one line, and without this machine's folders.
            words = (str(error).strip() or type(error).__name__).splitlines()[0]
            reasons.setdefault(engine, re.sub(r"/\S*/", "", words))

    for engine, threads, make in makers:
        # `make` is called before the generator goes on: it names its loops' variables.
        bursts[engine, threads] = try_to(engine, make)
    for _ in range(rounds):
        for (engine, threads), burst in bursts.items():
            if engine in reasons:
                continue
            runs = SLOW_BURST if engine.startswith(SLOW) else BURST
            for name, measured in (try_to(engine, lambda: burst(runs)) or {}).items():
                times.setdefault(engine + name, {}).setdefault(threads, []).extend(measured)
    return {engine: measured for engine, measured in times.items() if not engine.startswith(tuple(reasons))}, reasons


def of_each(statistic, by_threads):
    return {threads: statistic(measured) for threads, measured in by_threads.items()}


def time_table(results):
    rows = []
    for network, times, reasons in results:
        for engine, measured in times.items():
            cells = [f"{min(t):.2f} / {statistics.median(t):.2f}" if (t := measured.get(n)) else "" for n in THREADS]
            rows.append([network, engine, *cells])
        rows += [[network, engine, f"not run: {reason}", ""] for engine, reason in reasons.items()]
    return report.table(["network", "engine", *(f"{n} thread{'s' * (n > 1)}" for n in THREADS)], rows)


def ratio_table(results, statistic):
    """This engine's times over the others'."""
    others = ["OpenVINO", "ONNX Runtime", "ncnn", "rten", "tract"]
    rows = []
    for network, times, _ in results:
        for name in [OURS, OURS + WITH_PREPROCESSING]:
            if name not in times:
                continue
            ours, cells = of_each(statistic, times[name]), []
            for other in others:
                forms = [of_each(statistic, measured) for engine, measured in times.items() if engine.startswith(other)]
                best = {n: min(form[n] for form in forms if n in form) for n in THREADS if any(n in form for form in forms)}
                ratios = [ours[n] / best[n] for n in best if n in ours]
                cells.append(" / ".join(f"{ratio:.2f}" if ratio >= 0.1 else f"{ratio:.3f}" for ratio in ratios) or "-")
            rows.append([network + name.removeprefix(OURS), *cells])
    return report.table(["gedepth int8", *others], rows)


def threads_line(results):
    gains = []
    for _, times, _ in results:
        one, two = (times.get(OURS, {}).get(n) for n in THREADS)
        if one and two:
            gains.append((statistics.median(one) / statistics.median(two), min(one) / min(two)))
    by = [", ".join(f"{gain:.2f}" for gain in kind) for kind in zip(*gains)]
    return f"On two threads this engine is {by[0]} times as fast as on one by medians, {by[1]} by the least.\n" if by else ""


def versions():
    named = []
    for name, package in [("OpenVINO", "openvino"), ("ONNX Runtime", "onnxruntime"), ("ncnn", "ncnn"), ("pnnx", "pnnx")]:
        try:
            named.append(f"{name} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            pass
    named += [f"rten {report.locked('rten', HERE / 'rten/Cargo.lock')}", f"tract {report.locked('tract-onnx')}", f"Rust {report.rust()}"]
    return ", ".join(named)


def markdown(results, rounds, note):
    slow = " and ".join(SLOW)
    return "\n".join([
        f"{report.machine()}, {os.cpu_count()} cores{note and ', ' + note}, {datetime.date.today()}; {versions()}; milliseconds, least / "
        f"median of {rounds * BURST} in bursts of {BURST} ({slow}: {rounds * SLOW_BURST} in bursts of {SLOW_BURST}), all in turns in one run.\n",
        time_table(results),
        "![Milliseconds of a network, by engine](comparison.svg)\n",
        "This engine's time over that of the others (of int8 and f32 the quicker), by medians, 1 / 2 threads:\n",
        ratio_table(results, statistics.median),
        "The same by the least, which neighbours on a busy host disturb less:\n",
        ratio_table(results, min),
        threads_line(results),
    ]).rstrip() + "\n"


def figure(results):
    groups = []
    for network, times, _ in results:
        rows = [(engine, {f"{n} thread{'s' * (n > 1)}": m for n, m in of_each(statistics.median, measured).items()}) for engine, measured in times.items()]
        groups.append((network, rows))
    return report.bars(groups, "ms")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gedepth", default=report.ROOT / "target/release/gedepth", type=pathlib.Path)
    parser.add_argument("--rounds", default=5, type=int, help=f"bursts of {BURST} runs of each engine")
    parser.add_argument("--environment", default=pathlib.Path.home() / ".cache/gedepth-compare", type=pathlib.Path)
    parser.add_argument("--note", default="", help="a word about the machine, say that it was quiet")
    parser.add_argument("--readme", action="store_true", help="put tables and figure into benches/")
    arguments = parser.parse_args()
    enter_environment(arguments.environment)

    import onnx
    import unet

    rten_program = build_rten(arguments.environment)
    def files_of(name):
        return {form: report.ROOT / f"fixtures/models/{name}-{form}.onnx" for form in ["int8", "f32"]}

    tiny, shipped, large = (files_of(name) for name in ["tiny-adaptive", "adaptive", "large-adaptive"])
    results = []
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        metadata = {p.key: p.value for p in onnx.load(shipped["int8"]).metadata_props}
        metadata["gedepth.nominal_size"] = "1216x352"
        multiply_adds = unet.write(folder, (1216, 352), metadata)
        for network, files, size in [
            ("tiny adaptive, 640x192", tiny, (640, 192)),
            ("tiny adaptive, 1216x352", tiny, (1216, 352)),
            ("small adaptive, 640x192", shipped, (640, 192)),
            ("small adaptive, 1216x352", shipped, (1216, 352)),
            ("large adaptive, 1216x352", large, (1216, 352)),
            (f"U-Net of {multiply_adds / 1e9:.1f} GMAC, 1216x352",
             {form: folder / f"unet-{form}.onnx" for form in ["int8", "f32"]}, (1216, 352)),
        ]:
            results.append((network, *measure(engines(arguments, files, size, folder, rten_program), arguments.rounds)))
    text = markdown(results, arguments.rounds, arguments.note)
    print(text)
    if arguments.readme:
        report.put("compare.py", text)
        (report.README.parent / "comparison.svg").write_text(figure(results))


if __name__ == "__main__":
    main()
