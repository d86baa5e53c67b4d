#!/usr/bin/env python3
"""How time and memory grow with picture, cameras, threads and slope classes; prints the tables of README.md.

    cargo build --release --bin gedepth --bin road-scenes --bin core_scaling
    benches/scaling.py [--rounds N] [--runs N]           # print
    benches/scaling.py --readme                          # and put them into benches/README.md, and scaling.svg beside it

Needs Python alone. Everything is measured in turns, a burst of runs each, so that whatever disturbs the machine disturbs all
alike. Times are medians of all runs, the network's and that of the whole path: preprocessing, network, fusion. Pictures are
generated, as large as the network, and so is their depth. Cameras are processes of their own, which run at once; pictures a
second are theirs together, by the clock on the wall less that of a start.
"""

import argparse
import datetime
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

sys.dont_write_bytecode = True  # leaves nothing in the tree
import report

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", report.ROOT / "target"))
SIZES = [(320, 96), (480, 128), (640, 192), (960, 288), (1216, 352), (1600, 448), (1920, 544)]
CAMERAS = [1, 2, 3, 4, 5, 6]
THREADS = [1, 2, 3, 4]
CAMERA_SIZE = (640, 192)
THREAD_SIZES = [(640, 192), (1216, 352)]
WARM_UP = 5
# Runs of a camera at either end in which the others may not have started yet, or have ended.
ALONE = 0.15


def program(name):
    path = TARGET / "release" / name
    if not path.exists():
        raise SystemExit(f"{path} is not there: see the top of scaling.py")
    return path


def name(size):
    return f"{size[0]}x{size[1]}"


def scene(folder, size):
    """A generated picture with its calibration."""
    width, height = map(str, size)
    subprocess.run(
        [program("road-scenes"), "frames", "--width", width, "--height", height, "--camera", "fixed", "--terrain", "mixed",
         "--count", "1", "--out", folder / name(size)], check=True, stdout=subprocess.DEVNULL)
    return folder / name(size) / "scene_0000"


class Measured:
    """Milliseconds of runs, the peak memory of a process, and what it takes to know pictures a second."""

    def __init__(self):
        self.network, self.whole, self.bytes = [], [], 0
        self.pictures, self.seconds = 0, 0.0

    def median(self, what="whole"):
        return statistics.median(getattr(self, what))

    def p99(self):
        return sorted(self.whole)[round(0.99 * (len(self.whole) - 1))]

    def per_second(self):
        return self.pictures / self.seconds


def run(scene, size, threads, cameras, runs):
    """That many processes at once: the stages of their runs, the greatest peak memory, seconds until the last has ended."""
    command = [program("gedepth"), "bench", scene / "image.png", "--calibration", scene / "calibration.json", "--raw",
               "--network-size", name(size), "--threads", str(threads), "--runs", str(runs)]
    clock = time.perf_counter()
    outputs = [tempfile.TemporaryFile(mode="w+") for _ in range(cameras)]
    processes = [subprocess.Popen(command, stdout=output) for output in outputs]
    peak = 0
    for process in processes:
        # For the peak memory of this child alone.
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            raise SystemExit(f"{' '.join(map(str, command))}: exit status {process.returncode}")
        peak = max(peak, 1024 * usage.ru_maxrss)
    seconds = time.perf_counter() - clock
    stages = []
    for output in outputs:
        output.seek(0)
        stages.append([[float(time) / 1e3 for time in line.split()] for line in output])
        output.close()
    return stages, peak, seconds


def burst(measured, scene, size, threads, cameras, runs):
    """Adds what that many cameras measure."""
    stages, peak, seconds = run(scene, size, threads, cameras, runs + WARM_UP)
    measured.bytes = max(measured.bytes, peak)
    measured.pictures += cameras * runs
    measured.seconds += seconds - run(scene, size, threads, cameras, WARM_UP)[2]
    for times in stages:
        times = times[WARM_UP:]
        if cameras > 1:
            times = times[round(ALONE * len(times)):round((1 - ALONE) * len(times))]
        measured.network += [network for _, network, _ in times]
        measured.whole += [sum(run) for run in times]


def measure(rounds, runs):
    """By (size, threads, cameras)."""
    todo = {(size, threads, 1): Measured() for size in SIZES for threads in (1, 2)}
    todo |= {(CAMERA_SIZE, threads, cameras): Measured() for threads in (1, 2) for cameras in CAMERAS}
    todo |= {(size, threads, 1): Measured() for size in THREAD_SIZES for threads in THREADS}
    with tempfile.TemporaryDirectory() as folder:
        scenes = {size: scene(pathlib.Path(folder), size) for size in SIZES}
        for _ in range(rounds):
            for (size, threads, cameras), measured in todo.items():
                burst(measured, scenes[size], size, threads, cameras, runs)
    return todo


def measure_core(runs):
    """Microseconds {camera: {size: time}} of tables, and {classes: time} of fusion, by medians."""
    output = subprocess.run([program("core_scaling"), str(runs), *map(name, SIZES)], check=True, capture_output=True, text=True).stdout
    tables, fusion = {}, {}
    for line in output.splitlines():
        kind, what, width, height, _, median = line.split()
        if kind == "table":
            tables.setdefault(what, {})[int(width), int(height)] = float(median)
        else:
            fusion[int(what)] = float(median)
    return tables, fusion


def megapixels(size):
    return size[0] * size[1] / 1e6


def tables_of(measured, tables, fusion):
    def both(m):
        return [f"{m.median('network'):.2f}", f"{m.median():.2f}"]

    text = "**Size** (embedded adaptive int8; milliseconds, medians; peak memory of the process, two threads):\n\n"
    rows = []
    for size in SIZES:
        one, two = measured[size, 1, 1], measured[size, 2, 1]
        rows.append([name(size), *both(one), *both(two), f"{two.bytes / 1e6:.0f} MB", f"{1e6 * two.median() / (size[0] * size[1]):.1f}"])
    head = ["picture, network and depth", "network, 1 thread", "whole path", "network, 2 threads", "whole path", "memory", "ns a pixel, 2 threads"]
    text += report.table(head, rows)
    text += f"\n**Cameras** at once, each a process, {name(CAMERA_SIZE)} (milliseconds of a picture; pictures a second of all together):\n\n"
    rows = []
    for cameras in CAMERAS:
        cells = []
        for threads in (1, 2):
            m = measured[CAMERA_SIZE, threads, cameras]
            cells += [f"{m.median():.1f}", f"{m.p99():.1f}", f"{m.per_second():.0f}"]
        rows.append([str(cameras), *cells])
    head = ["cameras", "1 thread each: median", "p99", "pictures a second", "2 threads each: median", "p99", "pictures a second"]
    text += report.table(head, rows)
    text += f"\n**Threads** on {os.cpu_count()} cores (network / whole path, milliseconds, medians):\n\n"
    rows = [[str(n), *(" / ".join(both(measured[size, n, 1])) for size in THREAD_SIZES)] for n in THREADS]
    text += report.table(["threads", *map(name, THREAD_SIZES)], rows)
    text += "\n**Ground tables** (core, one core; milliseconds, and nanoseconds a pixel):\n\n"
    rows = []
    for size in SIZES:
        times = [tables[camera][size] for camera in tables]
        rows.append([name(size), *(f"{time / 1e3:.3f}, {time * 1e3 / (size[0] * size[1]):.2f}" for time in times)])
    text += report.table(["size", *tables], rows)
    text += "\n**Slope classes** (core's adaptive fusion at 1216x352, one core, slope at 1/8, the other heads at 1/2):\n\n"
    text += report.table(["classes", *map(str, fusion)], [["milliseconds", *(f"{time / 1e3:.2f}" for time in fusion.values())]])
    return text


def figure(measured, tables, fusion):
    def by_size(threads, what):
        return [(megapixels(size), measured[size, threads, 1].median(what)) for size in SIZES]

    def by_cameras(threads, value):
        return [(n, value(measured[CAMERA_SIZE, threads, n])) for n in CAMERAS]

    def by_threads(size, what):
        return [(n, measured[size, n, 1].median(what)) for n in THREADS]

    many = {1: "1 thread", 2: "2 threads"}
    pixels, milliseconds = "megapixels", "milliseconds"
    return report.panels([
        report.Panel("Latency against size", pixels, milliseconds, {
            f"{title}, {many[threads]}": by_size(threads, what)
            for threads in many for title, what in (("network", "network"), ("whole path", "whole"))}),
        report.Panel("Memory against size", pixels, "peak of the process, MB", {
            many[2]: [(megapixels(size), measured[size, 2, 1].bytes / 1e6) for size in SIZES]}),
        report.Panel(f"Cameras that share the cores, {name(CAMERA_SIZE)}", "cameras", "milliseconds a picture", {
            f"{title}, {many[threads]} each": by_cameras(threads, value)
            for threads in many for title, value in (("median", Measured.median), ("p99", Measured.p99))}),
        report.Panel(f"Threads on {os.cpu_count()} cores", "threads", milliseconds, {
            f"{title}, {name(size)}": by_threads(size, what)
            for size in THREAD_SIZES for title, what in (("network", "network"), ("whole path", "whole"))}),
        report.Panel("Ground table, one core; logarithmic", pixels, milliseconds, {
            camera: [(megapixels(size), time / 1e3) for size, time in times.items()] for camera, times in tables.items()}, log=True),
        report.Panel("Adaptive fusion, one core, 1216x352", "slope classes", milliseconds, {
            "heads at 1/2, slope at 1/8": [(classes, time / 1e3) for classes, time in fusion.items()]}),
    ])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", default=3, type=int, help="bursts of each")
    parser.add_argument("--runs", default=100, type=int, help="pictures of a burst")
    parser.add_argument("--note", default="", help="a word about the machine, say that it was quiet")
    parser.add_argument("--readme", action="store_true", help="put tables and figure into benches/")
    arguments = parser.parse_args()
    tables, fusion = measure_core(max(arguments.rounds * 10, 2))
    measured = measure(arguments.rounds, arguments.runs)
    text = f"{report.machine()}, {os.cpu_count()} cores{arguments.note and ', ' + arguments.note}, {datetime.date.today()}, "
    text += f"Rust {report.rust()}; {arguments.rounds} bursts of {arguments.runs} pictures each, in turns.\n\n"
    text += "![Time and memory against size, cameras, threads, slope classes](scaling.svg)\n\n"
    text += tables_of(measured, tables, fusion)
    print(text)
    if arguments.readme:
        report.put("scaling.py", text)
        (report.README.parent / "scaling.svg").write_text(figure(measured, tables, fusion))


if __name__ == "__main__":
    main()
