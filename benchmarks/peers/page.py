"""docs/benchmarks.md and its picture from the record of a run; `python page.py` writes them from the last one."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from task import CHAINS

REPOSITORY = Path(__file__).parents[2]
START, END = "<!-- figures: make bench-peers writes from here -->", "<!-- to here -->"
TITLES: Final = {
    "tick": "Computed torque, one tick",
    "impedance": "Impedance of the tool, one tick",
    "loop": "One loop",
    "sweep": "1024 loops at once, one core",
}
Record = Mapping[str, Any]
Rows = list[tuple[str, dict[str, Any]]]


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["|" + "|".join(f" {cell} " for cell in row) + "|" for row in (heads, *rows)]
    return "\n".join([lines[0], "|---" + "|--:" * (len(heads) - 1) + "|", *lines[1:]])


def number(value: float) -> str:
    return f"{value:.3g}" if value < 1e3 else f"{value:.0f}"


def rows_of(record: Record, **wanted: Any) -> Rows:
    """Title of the peer and row, of the cases that are like this."""
    pairs = ((peer["title"], row) for peer in record["peers"].values() for row in peer["rows"])
    return [(title, row) for title, row in pairs if wanted.items() <= row["case"].items()]


def timed(record: Record, **wanted: Any) -> Rows:
    """Those that ran."""
    return [(title, row) for title, row in rows_of(record, **wanted) if "seconds" in row]


def panda(rows: Rows) -> Rows:
    return [(title, row) for title, row in rows if "chain" not in row["case"].get("robot", "")]


def us(row: Mapping[str, Any], column: int = 0) -> float:
    """Median time of a step: of the peer, or of the case of taut in that column [us]."""
    return 1e6 * float(np.median(np.array(row["seconds"])[:, column]))


def times(row: Mapping[str, Any], column: int = 1) -> float:
    """How many times taut's time the peer takes: median over the rounds."""
    pairs = np.array(row["seconds"])
    return float(np.median(pairs[:, 0] / pairs[:, column]))


def beside(record: Record, kind: str) -> str:
    """A case: each peer with what it calls, or with what happened to it."""
    out = []
    for title, row in panda(rows_of(record, kind=kind)):
        if "error" in row:
            out.append([title, f"`{row['error']}`", *[""] * 4])
            continue
        over = "; ".join(number(times(row, 1 + k)) for k in range(len(row["mates"])))
        out.append([title, row["how"], number(us(row)), number(us(row, 1)), over, f"{row['difference']:.0e}"])
    over = "times `taut.run`; times `taut.sweep`" if kind == "loop" else "times taut's"
    return table(["", "what is called", "us a step", "taut's", over, "difference"], out)


def ahead(record: Record) -> str:
    """Where taut is slower."""
    words = [
        f"{title}, `{' '.join(map(str, row['case'].values()))}` ({times(row, k):.2f} of the time of `{mate['kind']}`)"
        for title, row in timed(record)
        for k, mate in enumerate(row["mates"], 1)
        if times(row, k) < 1.0
    ]
    return f"Ahead of taut in this run: {'; '.join(words) or 'no peer in any case'}."


def targets(record: Record) -> list[tuple[str, float, str, float]]:
    """Name, figure, sign and target."""
    ratios, speeds, (took, megabytes) = record["ratios"], record["speeds"], record["million"]
    wide = record["lanes"]["double"] == 8
    least = {
        "double lanes over the scalar loop, one core": 4.8 if wide else 3.2,
        "float lanes over the scalar loop, one core": 9.5 if wide else 6.5,
        "two threads over one": 1.8,
    }
    out = [(name, ratios[name], ">=", target) for name, target in least.items()]
    for name, kind, target in (("pinocchio", "loop", 400.0), ("mujoco", "loop", 350.0), ("jax", "sweep", 50.0)):
        for title, row in panda(timed({"peers": {name: record["peers"][name]}}, kind=kind))[:1]:
            figure = speeds["double, two threads, wall"] * us(row)
            out.append((f"two threads over one process of {title}", figure, ">=", target))
    return [
        *out,
        ("a million loops of 1 s, two threads [s]", took, "<=", 45.0),
        ("their peak memory [MB]", megabytes, "<=", 400.0),
        ("`taut.run` of 2000 ticks, everything recorded [million steps/s]", speeds["taut.run"], ">=", 1.5),
    ]


def target_table(record: Record) -> str:
    rows = []
    for name, value, sign, target in targets(record):
        met = value >= target if sign == ">=" else value <= target
        rows.append([name, number(value), f"{sign} {target:g}", "yes" if met else "**no**"])
    missed, words = sum("no" in row[-1] for row in rows), ""
    if record["lanes"]["double"] != 8:
        words = (
            ". The first two are targets for this processor, the others for one with 8 doubles in a lane: with "
            "fewer, sweeps take longer, and the targets of their speed may be missed. `taut.run` has no lanes, and "
            "depends on the speed of a core alone"
        )
    return f"{table(['', 'measured', 'target', 'met'], rows)}\n\nMissed: {missed} of {len(rows)}{words}."


def joints(record: Record) -> str:
    """Growth with the number of joints, with Pinocchio beside it."""
    rows = []
    for n, *own in record["joints"]:
        cells = [f"{x:g}" for x in (n, *own)]
        for kind in ("tick", "loop"):
            found = timed(record, kind=kind, robot=f"chain{n}")
            order = (2, 1, 0) if kind == "loop" else (1, 0)
            cells += [number(us(row, column)) for _, row in found for column in order] or [""] * len(order)
        rows.append(cells)
    heads = ["joints", "operations", "compile [ms]", "cached [ms]", "bound tick [us]"]
    return table([*heads, "`ctrl.step` [us]", "Pinocchio's", "fused loop [us]", "`taut.run`", "Pinocchio's"], rows)


def growth(record: Record) -> str:
    """Growth with laws, lanes, threads and samples."""
    counts = [*record["samples"], [1_000_000, record["million"][0]]]
    pieces = [
        table(
            ["law on the Panda", "operations", "bound tick [us]"],
            [[name, f"{operations}", f"{time:.2f}"] for name, operations, time in record["laws"]],
        ),
        table(
            ["lanes and threads; wall: by the clock", "million steps/s"],
            [[name, number(x)] for name, x in record["speeds"].items()],
        ),
        table(
            ["loops of 1 s in one `taut.sweep`, two threads", "time [s]", "million steps/s"],
            [[f"{n}", number(time), number(1e-3 * n / time)] for n, time in counts],
        ),
    ]
    return "\n\n".join(pieces)


def versions(record: Record) -> str:
    """Versions, and peers that could not be asked."""
    rows = []
    for peer in record["peers"].values():
        packages = ", ".join(f"{name} {version}" for name, version in peer["packages"].items())
        rows.append([peer["title"], packages, f"`{peer['error']}`" if "error" in peer else "ran"])
    return table(["", "versions", ""], rows)


def figures(record: Record) -> str:
    """All tables."""
    where = record["machine"]
    libraries = ", ".join(f"{name} {version}" for name, version in where["versions"].items())
    head = [
        f"`make bench-peers` on {where['cores']} cores, {where['processor']}, {record['lanes']['double']} doubles",
        f"in a lane; {where['system']}, Python {where['python']}, {libraries}; medians of {record['rounds']} rounds;",
        f"load of the machine at the start {where['load']:.1f}.",
    ]
    sections = {title: beside(record, kind) for kind, title in TITLES.items()}
    sections["Targets"] = target_table(record)
    sections |= {"Growth": f"{joints(record)}\n\n{growth(record)}", "Versions": versions(record)}
    text = "\n\n".join(f"## {title}\n\n{text}" for title, text in sections.items())
    return f"{' '.join(head)}\n\n{ahead(record)}\n\n{text}"


def picture(record: Record, file: Path) -> None:
    """Closed-loop steps a second, and cost over the number of joints."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.6), layout="constrained")
    speeds = {title: 1e6 / us(row) for title, row in panda(timed(record, kind="loop"))}
    many = timed(record, kind="sweep", real="float64")
    speeds |= {f"{title}, 1024 at once": 1e6 / us(row) for title, row in many}
    own = {"taut.run": "taut.run", "taut.sweep, one core": "double"}
    own |= {"taut.sweep, two threads": "double, two threads, wall"}
    speeds |= {name: 1e6 * record["speeds"][key] for name, key in own.items()}
    order = sorted(speeds, key=speeds.__getitem__)
    left.barh(order, [speeds[name] for name in order], color=["C0" if name in own else "0.7" for name in order])
    left.set(xscale="log", xlabel="steps/s: Panda, computed torque, nothing in contact")
    for k, (kind, words) in enumerate((("tick", "tick from Python"), ("loop", "step of a loop"))):
        chains = [(n, row) for n in CHAINS for _, row in timed(record, kind=kind, robot=f"chain{n}")]
        for column, style, who in ((1 + k, "o-", "taut"), (0, "s--", "NumPy + Pinocchio")):
            cost = [us(row, column) for _, row in chains]
            right.plot([n for n, _ in chains], cost, f"C{k}{style}", label=f"{who}, {words}")
    right.set(xscale="log", yscale="log", xlabel="joints of a chain", ylabel="us", xticks=CHAINS)
    right.xaxis.set_major_formatter("{x:g}")
    right.minorticks_off()
    right.legend(fontsize="small")
    right.grid(alpha=0.3)
    figure.savefig(file, dpi=130)
    plt.close(figure)


def written(text: str, record: Record) -> str:
    """The page with the figures of this record between its two marks."""
    before, rest = text.split(START)
    return f"{before}{START}\n\n{figures(record)}\n\n{END}{rest.split(END)[1]}"


def write(record: Record) -> None:
    page = REPOSITORY / "docs" / "benchmarks.md"
    page.write_text(written(page.read_text(encoding="utf-8"), record), encoding="utf-8")
    picture(record, REPOSITORY / "docs" / "images" / "benchmarks.png")


if __name__ == "__main__":
    write(json.loads((REPOSITORY / "out" / "bench_peers" / "record.json").read_text()))
