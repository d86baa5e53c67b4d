#!/usr/bin/env python3
"""Where the network's time goes, layer by layer, beside what one core could do at best; prints the table of README.md.

    cargo build --release --bin gedepth --bin roofs
    benches/roofline.py [--rounds N] [--runs N]          # print
    benches/roofline.py --readme                         # and put it into benches/README.md, and roofline.svg beside it

Needs Python alone. The embedded model at 1216x352 on one thread, the street scene. A layer's time is the median of the rounds, a
process each, which prints means of its runs; the roofs are the best of all rounds. A layer's bytes are the least that it can
move: inputs and weights read once, the output written once. Its roof is the lower of the peak of multiply-adds and of what the
cache that holds these bytes delivers; layers that multiply nothing have only the latter.
"""

import argparse
import collections
import datetime
import math
import os
import pathlib
import re
import statistics
import subprocess
import sys

sys.dont_write_bytecode = True  # leaves nothing in the tree
import report

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", report.ROOT / "target"))
SCENE = report.ROOT / "fixtures/scenes/street"
SIZE = "1216x352"
CACHES = pathlib.Path("/sys/devices/system/cpu/cpu0/cache")
# What is drawn, in this order; all else has no multiply-adds.
KINDS = ["dense 3x3", "1x1", "blocks", "other convolutions"]


def output(name, *arguments):
    """Lines that a program of this repository prints."""
    path = TARGET / "release" / name
    if not path.exists():
        raise SystemExit(f"{path} is not there: see the top of roofline.py")
    return subprocess.run([path, *map(str, arguments)], check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()


class Layer:
    def __init__(self, line):
        microseconds, million, megabytes, _, *operation, self.shape, self.output = line.split()
        self.operation = " ".join(operation)
        self.seconds = [float(microseconds) / 1e6]
        self.multiply_adds, self.bytes = 1e6 * float(million), 1e6 * float(megabytes)

    def time(self):
        return statistics.median(self.seconds)

    def kind(self):
        # Of several layers that run as one, the one with weights; a depthwise one always runs with others.
        found = re.search("depthwise", self.operation) or re.search(r"convolution (\S+)", self.operation)
        if not found:
            return self.operation
        if found[0] == "depthwise":
            return "blocks"
        return {"3x3": "dense 3x3", "1x1": "1x1"}.get(found[1], "other convolutions")


def measure_layers(runs):
    lines = output("gedepth", "bench", SCENE / "image.png", "--calibration", SCENE / "calibration.json", "--profile",
                   "--network-size", SIZE, "--threads", 1, "--runs", runs)
    first = next(i for i, line in enumerate(lines) if line.split()[:1] == ["us"]) + 1
    return [Layer(line) for line in lines[first:]]


def measure_roofs():
    """The peak, multiply-adds a second, and {bytes of memory: bytes a second}."""
    peak, bandwidths = None, {}
    for line in output("roofs"):
        what, *numbers = line.split()
        if what == "peak":
            peak = 1e9 * float(numbers[0])
        else:
            bandwidths[int(numbers[0])] = 1e9 * float(numbers[1])
    if peak is None:
        raise SystemExit("this processor has no AVX-512 VNNI, whose peak is the roof")
    return peak, bandwidths


def cache(level):
    """Bytes of a core's cache."""
    size = (CACHES / f"index{level}/size").read_text().strip()
    return int(size[:-1]) << {"K": 10, "M": 20}[size[-1]]


class Roofs:
    def __init__(self, rounds):
        self.peak = max(peak for peak, _ in rounds)
        l2, l3, memory = (max(round[size] for _, round in rounds) for size in sorted(rounds[0][1]))
        # Name, bytes that it holds, bytes a second.
        self.levels = [("L2 cache", cache(2), l2), ("L3 cache", cache(3), l3), ("memory", math.inf, memory)]

    def least(self, layer):
        """Seconds that a layer takes at best."""
        bandwidth = next(bandwidth for _, holds, bandwidth in self.levels if layer.bytes <= holds)
        return max(layer.multiply_adds / self.peak, layer.bytes / bandwidth)


def measure(rounds, runs):
    layers, roofs = [], []
    for _ in range(rounds):
        roofs.append(measure_roofs())
        measured = measure_layers(runs)
        for layer, more in zip(layers, measured):
            layer.seconds += more.seconds
        layers = layers or measured
    # Preprocessing writes bytes, so that quantizing takes no time.
    return [layer for layer in layers if layer.time() > 0], Roofs(roofs)


def table_of(layers, roofs):
    kinds = collections.defaultdict(list)
    for layer in layers:
        kinds[layer.kind()].append(layer)
    whole = sum(layer.time() for layer in layers)
    order = [kind for kind in KINDS if kind in kinds] + sorted(kinds.keys() - set(KINDS))

    def row(name, group):
        seconds = sum(layer.time() for layer in group)
        multiply_adds, moved = sum(layer.multiply_adds for layer in group), sum(layer.bytes for layer in group)
        return [name, str(len(group)), f"{1e3 * seconds:.2f}", f"{100 * seconds / whole:.0f} %",
                f"{multiply_adds / seconds / 1e9:.0f}" if multiply_adds else "", f"{moved / seconds / 1e9:.0f}",
                f"{100 * sum(map(roofs.least, group)) / seconds:.0f} %"]

    head = ["layers", "number", "ms", "of the time", "GMAC/s", "GB/s", "of the roof"]
    return report.table(head, [row(kind, kinds[kind]) for kind in order] + [row("all", layers)])


def figure(layers, roofs):
    """Logarithmic, with a circle for each convolution, whose area is its time."""
    width, height = 760, 500
    left, right, top, floor = 62, 740, 112, 452
    drawn = [layer for layer in layers if layer.kind() in KINDS]
    points = [(layer, layer.multiply_adds / layer.bytes, layer.multiply_adds / layer.time() / 1e9) for layer in drawn]
    peak = roofs.peak / 1e9
    x_axis = report.Axis([1, *(x for _, x, _ in points)], left, right, 8, log=True)
    y_axis = report.Axis([peak, *(y for _, _, y in points)], floor, top, 8, log=True)
    parts = [report.label(left, 24, f"Layers of the embedded network, {SIZE}, one thread: area of a circle is its time", 'font-weight="bold"')]
    for tick in y_axis.ticks:
        at = y_axis.at(tick)
        parts += [f'<path d="M{left} {at:.1f}H{right}" stroke="#ddd"/>', report.label(left - 6, at + 4, f"{tick:g}", 'text-anchor="end"')]
    for tick in x_axis.ticks:
        at = x_axis.at(tick)
        parts += [f'<path d="M{at:.1f} {top}V{floor + 4}" stroke="#ddd"/>', report.label(at, floor + 17, f"{tick:g}", 'text-anchor="middle"')]
    parts.append(f'<path d="M{left} {top}V{floor}H{right}" fill="none" stroke="#888"/>')
    parts.append(report.label((left + right) / 2, height - 10, "multiply-adds per byte moved", 'text-anchor="middle"'))
    middle = (top + floor) / 2
    parts.append(report.label(14, middle, "GMAC/s", f'text-anchor="middle" transform="rotate(-90 14 {middle:.1f})"'))

    # Roofs: each begins where it enters the frame, and all end under the peak.
    lines = [(f"peak of one core: {peak:.0f} GMAC/s", "", [(x_axis.low, peak), (x_axis.high, peak)])]
    for (name, _, bandwidth), dashes in zip(roofs.levels, ["", "7 4", "2 4"]):
        slope = bandwidth / 1e9
        begin = max(x_axis.low, y_axis.low / slope)
        if begin * slope < peak:
            lines.append((f"{name}: {slope:.0f} GB/s", dashes, [(begin, begin * slope), (peak / slope, peak)]))
    for i, (name, dashes, ends) in enumerate(lines):
        (x1, y1), (x2, y2) = [(x_axis.at(x), y_axis.at(y)) for x, y in ends]
        stroke = f'stroke="{"#222" if i == 0 else "#777"}" stroke-width="{2.5 if i == 0 else 1.5}" stroke-dasharray="{dashes or "none"}"'
        parts.append(f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" {stroke}/>')
        x, y = left + 340, 46 + 17 * i
        parts += [f'<path d="M{x} {y - 4}h28" {stroke}/>', report.label(x + 36, y, name)]

    # The large ones first, so that none hides another.
    longest = max(layer.time() for layer in drawn)
    colours = dict(zip(KINDS, report.COLOURS))
    for layer, x, y in sorted(points, key=lambda point: -point[0].time()):
        # At least so large that it is seen.
        radius = max(2.5, 15 * math.sqrt(layer.time() / longest))
        colour, title = colours[layer.kind()], f"<title>{layer.output}, {layer.operation}, {1e6 * layer.time():.0f} us</title>"
        parts.append(f'<circle cx="{x_axis.at(x):.1f}" cy="{y_axis.at(y):.1f}" r="{radius:.1f}" fill="{colour}" fill-opacity="0.45" '
                     f'stroke="{colour}">{title}</circle>')
    for i, kind in enumerate(kind for kind in KINDS if any(layer.kind() == kind for layer in drawn)):
        x, y = left + 8, 46 + 17 * i
        parts += [f'<circle cx="{x}" cy="{y - 4}" r="5.5" fill="{colours[kind]}" fill-opacity="0.45" stroke="{colours[kind]}"/>',
                  report.label(x + 14, y, kind)]
    return report.svg(width, height, parts)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", default=5, type=int, help="processes, and measurements of the roofs")
    parser.add_argument("--runs", default=100, type=int, help="pictures of a process")
    parser.add_argument("--note", default="", help="a word about the machine, say that it was quiet")
    parser.add_argument("--svg", type=pathlib.Path, help="put the figure there, to look at it")
    parser.add_argument("--readme", action="store_true", help="put table and figure into benches/")
    arguments = parser.parse_args()
    layers, roofs = measure(arguments.rounds, arguments.runs)
    text = f"{report.machine()}, one core{arguments.note and ', ' + arguments.note}, {datetime.date.today()}, "
    text += f"Rust {report.rust()}; the embedded network at {SIZE}, {arguments.rounds} rounds of {arguments.runs} pictures. "
    text += f"Peak of `vpdpbusd` {roofs.peak / 1e9:.0f} GMAC/s; "
    text += ", ".join(f"{name} {bandwidth / 1e9:.0f}" for name, _, bandwidth in roofs.levels) + " GB/s read and written.\n\n"
    text += "![Multiply-adds a second of each layer, under the roofs](roofline.svg)\n\n"
    text += table_of(layers, roofs)
    print(text)
    if arguments.svg:
        arguments.svg.write_text(figure(layers, roofs))
    if arguments.readme:
        report.put("roofline.py", text)
        (report.README.parent / "roofline.svg").write_text(figure(layers, roofs))


if __name__ == "__main__":
    main()
