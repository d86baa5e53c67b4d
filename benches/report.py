"""What compare.py and scaling.py share: the machine in a line, Markdown, README.md, and figures as SVG."""

import html
import math
import pathlib
import platform
import re
import subprocess

ROOT = pathlib.Path(__file__).resolve().parent.parent
README = ROOT / "benches/README.md"
COLOURS = ["#d1495b", "#3a7ca5", "#edae49", "#66a182", "#7b5ea7", "#888888"]


def machine():
    """The processor, by its family where its name does not tell, and its instructions for int8."""
    name, family, flags = platform.processor(), "", ""
    for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines():
        key, _, value = line.partition(":")
        if key.strip() == "model name":
            name = value.strip()
        elif key.strip() == "cpu family":
            family = f" (family {value.strip()})"
        elif key.strip() in ("flags", "Features"):
            flags = value.split()
    known = {"avx512_vnni": "AVX-512 VNNI", "avx_vnni": "AVX-VNNI", "avx2": "AVX2", "i8mm": "i8mm", "asimddp": "dot product"}
    best = next((title for flag, title in known.items() if flag in flags), None)
    return f"{name}{family} with {best}" if best else name + family


def locked(package, lock=ROOT / "Cargo.lock"):
    """The version of a crate in a Cargo.lock."""
    return re.search(rf'name = "{package}"\nversion = "(.*?)"', lock.read_text()).group(1)


def rust():
    return subprocess.run(["rustc", "--version"], check=True, capture_output=True, text=True).stdout.split()[1]


def table(head, rows):
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows]) + "\n"


def put(script, text):
    """Puts `text` between the script's marks in README.md."""
    begin, end = f"<!-- {script} -->\n", f"<!-- /{script} -->\n"
    before, rest = README.read_text().split(begin)
    README.write_text(f"{before}{begin}\n{text}\n{end}{rest.split(end)[1]}")


def svg(width, height, parts):
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">'
    return "\n".join([head, f'<rect width="{width}" height="{height}" fill="white"/>', *parts, "</svg>"]) + "\n"


def label(x, y, text, more=""):
    return f'<text x="{x:.1f}" y="{y:.1f}"{" " if more else ""}{more}>{html.escape(text)}</text>'


def step(top, most):
    """The least of 1, 2, 5, 10, 20, ... that cuts `top` into at most `most` parts."""
    unit = 10.0 ** math.floor(math.log10(top / most))
    return next(unit * factor for factor in (1, 2, 5, 10) if top / (unit * factor) <= most)


def ticks(top, most):
    size = step(top, most)
    return [size * i for i in range(math.floor(top / size + 1e-9) + 1)]


class Axis:
    """Where values lie between two places of a picture, and its ticks."""

    def __init__(self, values, begin, end, ticks_at_most, log):
        self.begin, self.end, self.log = begin, end, log
        self.low, self.high = 0.0, max(values) * 1.06
        self.ticks = ticks(self.high, ticks_at_most)
        if log:
            self.low, self.high = min(values) / 1.5, max(values) * 1.5
            factors = (1, 2, 5) if self.high / self.low < 300 else (1,)
            decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)))
            wanted = [factor * 10.0 ** i for i in decades for factor in factors]
            self.ticks = [tick for tick in wanted if self.low <= tick <= self.high]

    def at(self, value):
        share = math.log(value / self.low) / math.log(self.high / self.low) if self.log else value / self.high
        return self.begin + (self.end - self.begin) * share


class Panel:
    """Curves {name: [(x, y), ...]} in a frame of WIDTH x HEIGHT, labels included; `log` for logarithmic axes."""

    WIDTH, HEIGHT = 440, 320
    LEFT, RIGHT, BOTTOM = 62, 20, 44
    ENTRIES = 2  # of the legend in a row

    def __init__(self, title, x_label, y_label, series, log=False):
        self.title, self.x_label, self.y_label, self.series = title, x_label, y_label, series
        self.above = 34 + 17 * math.ceil(len(series) / self.ENTRIES)
        points = [point for curve in series.values() for point in curve]
        self.x = Axis([x for x, _ in points], self.LEFT, self.WIDTH - self.RIGHT, 8, log)
        self.y = Axis([y for _, y in points], self.HEIGHT - self.BOTTOM, self.above, 6, log)

    def draw(self, left, up):
        """The panel with its corner there."""
        parts = [f'<g transform="translate({left} {up})">', label(self.LEFT, 20, self.title, 'font-weight="bold"')]
        end, floor = self.WIDTH - self.RIGHT, self.HEIGHT - self.BOTTOM
        for tick in self.y.ticks:
            at = self.y.at(tick)
            parts.append(f'<path d="M{self.LEFT} {at:.1f}H{end}" stroke="#ddd"/>')
            parts.append(label(self.LEFT - 6, at + 4, f"{tick:g}", 'text-anchor="end"'))
        for tick in self.x.ticks:
            at = self.x.at(tick)
            parts.append(f'<path d="M{at:.1f} {floor}v4" stroke="#888"/>')
            parts.append(label(at, floor + 17, f"{tick:g}", 'text-anchor="middle"'))
        parts.append(f'<path d="M{self.LEFT} {self.above}V{floor}H{end}" fill="none" stroke="#888"/>')
        parts.append(label((self.LEFT + end) / 2, self.HEIGHT - 8, self.x_label, 'text-anchor="middle"'))
        middle = (self.above + floor) / 2
        turned = f'text-anchor="middle" transform="rotate(-90 14 {middle:.1f})"'
        parts.append(label(14, middle, self.y_label, turned))
        for i, (name, curve) in enumerate(self.series.items()):
            colour = COLOURS[i % len(COLOURS)]
            x = self.LEFT + (end - self.LEFT) / self.ENTRIES * (i % self.ENTRIES)
            y = 40 + 17 * (i // self.ENTRIES)
            parts.append(f'<path d="M{x:.1f} {y - 4}h18" stroke="{colour}" stroke-width="2.5"/>')
            parts.append(label(x + 24, y, name))
            points = " ".join(f"{self.x.at(x):.1f},{self.y.at(y):.1f}" for x, y in curve)
            parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>')
            parts += [f'<circle cx="{self.x.at(x):.1f}" cy="{self.y.at(y):.1f}" r="2.6" fill="{colour}"/>' for x, y in curve]
        return parts + ["</g>"]


def panels(all_of_them, columns=2):
    """A figure of panels, row by row."""
    parts = []
    for i, panel in enumerate(all_of_them):
        parts += panel.draw(Panel.WIDTH * (i % columns), Panel.HEIGHT * (i // columns))
    return svg(Panel.WIDTH * columns, Panel.HEIGHT * math.ceil(len(all_of_them) / columns), parts)


def bars(groups, unit, most=6):
    """A figure of bars: [(title, [(name, {legend: value})])]. Bars end at `most` times a group's shortest first one, and say
    their value."""
    left, right, thick, gap = 216, 640, 11, 9
    legends = list(dict.fromkeys(legend for _, rows in groups for _, values in rows for legend in values))
    colours = dict(zip(legends, [COLOURS[1], COLOURS[0], *COLOURS[2:]]))
    parts, y = [], 14
    for i, legend in enumerate(legends):
        x = left + 110 * i
        parts += [f'<rect x="{x}" y="{y - 4}" width="18" height="{thick}" fill="{colours[legend]}"/>', label(x + 24, y + 6, legend)]
    y += 30
    for title, rows in groups:
        parts.append(label(12, y + 4, title, 'font-weight="bold"'))
        y += 18
        firsts = [next(iter(values.values())) for _, values in rows]
        longest = max(value for _, values in rows for value in values.values())
        end = min(longest * 1.02, most * min(firsts))
        scale = (right - left) / end
        begin = y
        drawn = []
        for name, values in rows:
            height = thick * len(values)
            drawn.append(label(left - 8, y + height / 2 + 4, name, 'text-anchor="end"'))
            for legend, value in values.items():
                width = scale * min(value, end)
                drawn.append(f'<rect x="{left}" y="{y}" width="{width:.1f}" height="{thick - 1}" fill="{colours[legend]}"/>')
                if value > end:
                    # A gap in the bar: it would be longer.
                    drawn.append(f'<path d="M{right - 22} {y + thick}l6 {-thick - 1}h5l-6 {thick + 1}z" fill="white"/>')
                drawn.append(label(left + width + 5, y + 9.5, f"{value:.1f}", 'font-size="11" stroke="white" stroke-width="3" paint-order="stroke"'))
                y += thick
            y += gap
        for tick in ticks(end, 8):
            x = left + scale * tick
            parts.append(f'<path d="M{x:.1f} {begin - 4}V{y - 4}" stroke="#ddd"/>')
            parts.append(label(x, y + 8, f"{tick:g}", 'text-anchor="middle" fill="#555"'))
        parts += drawn + [label(right + 22, y + 8, unit, 'fill="#555"')]
        y += 36
    return svg(700, y - 12, parts)
