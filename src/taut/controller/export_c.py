"""A controller as C99 for firmware: header, source, self-test with vectors from Python, Makefile and CMakeLists."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal

import numpy as np

from taut.base import __version__
from taut.base.checks import instance_of, one_of
from taut.base.errors import FileError, UsageError
from taut.base.types import Float64Array
from taut.codegen.c import DOUBLE, SINGLE, Precision, Struct, body, comment, member, prelude
from taut.codegen.program import Block, Program, trace
from taut.control.law import Law
from taut.control.lawside import HELD, KNOWN
from taut.controller.controller import Controller
from taut.controller.kernel import DT, SideFunctions
from taut.maths.snapshot import snapshot

MARK: Final = "made by taut"  # in the first line of each file, which is then made anew; others are left alone
TICKS: Final = 16  # of the self-test
TOLERANCE: Final = {"double": 1e-9, "float": 1e-4}  # of the largest command
UNITS: Final = {
    "t": "s: since the first tick",
    "q": "rad | m",
    "v": "rad/s | m/s",
    "F_ext": "N, N m: of the environment on the arm at the tool, force first, world axes",
    "tau_meas": "N m | N",
    "q_motor": "rad | m: motor angle / gear",
    "v_motor": "rad/s | m/s: of the motor / gear",
    "a_tip": "m/s^2: proper acceleration, tool axes",
    KNOWN: "1 where the plant holds a known torque at the start, else 0: then the model's gravity torque",
    HELD: "N m | N: that torque",
    "ref.q": "rad | m",
    "ref.v": "rad/s | m/s",
    "ref.a": "rad/s^2 | m/s^2",
    "ref.j": "rad/s^3 | m/s^3",
    "ref.s": "rad/s^4 | m/s^4",
    "ref.p": "m: in the world",
    "ref.R": "rotation: its columns are the tool's axes in the world",
    "ref.twist": "m/s, rad/s: linear first, world axes",
    "ref.acceleration": "m/s^2, rad/s^2",
    "ref.F_app": "N, N m: of the arm on the environment at the tool, force first, world axes",
    "ref.F_world": "N, N m: the same, the part in world axes",
    "ref.F_tool": "N, N m: the part in the tool's axes",
    "ref.press": "N: into the surface of the first row",
    "ref.lam": "N, N m: multipliers of eq. 10.40 by row, in place of press",
    "ref.given": "number of multipliers that are given",
    DT: "s: the period",
}
COMMANDS: Final = {"velocity": "v", "position": "q"}  # whose unit each has; that of torques otherwise


def export_c(
    ctrl: Controller,
    folder: str | os.PathLike[str],
    *,
    prefix: str = "ctrl",
    real: Literal["double", "float"] = "double",
) -> list[Path]:
    """A controller as C99 for firmware: a header, a source, a self-test, a Makefile and a CMakeLists.txt.

    The code allocates nothing and needs math.h alone. Parameters, memory and inputs are structs whose members are
    taut's paths: `parameters.law.kp` is "law.kp". The parameters start as they are in `ctrl` now. A tick with a
    number that is not finite leaves memory and command as they were, and says so. The self-test runs sixteen ticks
    whose commands Python computed.

    Args:
        ctrl: The controller of a law.
        folder: Where the files go; made if it is not there. Files that taut wrote before are replaced.
        prefix: What the names of files, types and functions begin with, an identifier of C.
        real: The type of all numbers.

    Returns:
        The files.

    Raises:
        UsageError: Not a controller or a path, a controller of a task, or a prefix that is no identifier.
        FileError: A folder that cannot be written, or another file of the same name.

    Example:
        >>> import tempfile, taut
        >>> ctrl = taut.compile(taut.laws.PID(kp=100.0, kd=20.0), taut.load_arm("planar2"))
        >>> [file.name for file in taut.export_c(ctrl, tempfile.mkdtemp(), prefix="pd")]
        ['pd.h', 'pd.c', 'pd_test.c', 'Makefile', 'CMakeLists.txt']
    """
    instance_of("ctrl", ctrl, Controller, "a controller from taut.compile")
    target = os.fspath(folder) if isinstance(folder, (str, os.PathLike)) else None
    if not isinstance(target, str) or not target or "\0" in target:
        raise UsageError(f"folder must be the path of a folder, a str or a Path; got {folder!r}", name="folder")
    one_of("real", real, tuple(TOLERANCE))
    if not isinstance(prefix, str) or member(prefix or " ") != prefix:
        raise UsageError(f"prefix must be an identifier of C, such as 'ctrl'; got {prefix!r}", name="prefix")
    if ctrl.side.task is not None:
        raise UsageError(
            "export_c is for a law, whose reference is written from outside; the references of a task are made by "
            "Python as its phases begin: export the law of each phase",
            name="ctrl",
        )
    return Firmware(ctrl, prefix, DOUBLE if real == "double" else SINGLE).write(Path(target))


def _unit(path: str) -> str:
    """Unit of an input; the samples of laws side by side have the part's name first, as in ref.left_p."""
    own = (unit for name, unit in UNITS.items() if name[:4] == "ref." and path.endswith(f"_{name[4:]}"))
    unit = UNITS.get(path) or next(own, "")
    return f"{unit}, by joint" if "|" in unit else unit


class Firmware:
    """The files of one exported controller."""

    def __init__(self, ctrl: Controller, prefix: str, precision: Precision) -> None:
        self.ctrl, self.prefix, self.precision = ctrl, prefix, precision
        self.tick, functions = ctrl.program, SideFunctions(ctrl.side, record=False)
        self.start = trace(functions.start, self.tick.inputs, self.tick.parameters, Block())
        assert self.start.outputs.shapes == self.tick.memory.shapes
        self.values = self.tick.parameters.pack({**ctrl.parameters, DT: ctrl.dt})
        blocks = {name: getattr(self.tick, name) for name in ("inputs", "parameters", "memory", "outputs")}
        self.structs = {name: Struct(block) for name, block in blocks.items()}

    def write(self, folder: Path) -> list[Path]:
        """Write the files; a file that taut did not write stays, and none is written then."""
        p = self.prefix
        texts = {f"{p}.h": self.header(), f"{p}.c": self.source(), f"{p}_test.c": self.test()}
        texts |= {"Makefile": self.makefile(), "CMakeLists.txt": self.cmake()}
        for file in (folder / name for name in texts):
            if file.is_file() and MARK.encode() not in file.read_bytes().partition(b"\n")[0]:
                raise FileError(
                    f"'{file}' is there and was not {MARK}; name another folder or move it away", name=str(file)
                )
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name, text in texts.items():
                (folder / name).write_text(text, encoding="utf-8")
        except OSError as cause:
            raise FileError(f"'{folder}' cannot be written: {cause.strerror}", name=str(folder)) from cause
        return [folder / name for name in texts]

    def _head(self, what: str) -> list[str]:
        side, version = self.ctrl.side, f"{MARK} {__version__}"
        return [
            f"/* {what}: {version}; make it anew rather than edit it.",
            f" * {comment(side.title)} for arm '{comment(side.arm.name)}', {side.arm.n} joints, at {side.rate:g} Hz, "
            f"in {self.precision.real}.",
            " * SPDX-License-Identifier: Apache-2.0 (what taut wrote; a law of your own stays yours) */",
        ]

    def header(self) -> str:
        """Types, parameters, functions, and how to use them."""
        p, real, side = self.prefix, self.precision.real, self.ctrl.side
        notes = {path: _unit(path) for path in (*self.tick.inputs.shapes, DT)}
        notes |= {path: unit for path, unit in side.units.items() if unit}
        commanded = UNITS[COMMANDS.get(side.gives, "tau_meas")]
        notes |= {"mit": "rows q, v, kp, kd, tau", "command": commanded}
        assert isinstance(side.law, Law)  # export_c refuses tasks
        notes |= {f"law.{path}": memory.unit for path, memory in side.law.every_memory().items() if memory.unit}
        limited = {path: shape for path, shape in self.tick.memory.shapes.items() if path.startswith("limits.")}
        notes |= {path: commanded if shape else "1" for path, shape in limited.items()}
        joints = (
            f"{comment(name)} [{unit}]" for name, unit in zip(side.arm.joint_names, side.arm.units, strict=True)
        )
        lines = [
            *self._head(f"{p}.h"),
            f"#ifndef {p.upper()}_H",
            f"#define {p.upper()}_H",
            "#ifdef __cplusplus",
            'extern "C" {',
            "#endif",
            "",
            f"/* Joints, in order: {', '.join(joints)}.",
            " *",
            f" *     static {p}_memory memory;",
            f" *     {p}_inputs inputs = {p}_zero;      measure and set the reference in every tick",
            f" *     {p}_outputs outputs;",
            f" *     {p}_start(&inputs, &{p}_defaults, &memory);            once, from the first inputs",
            f" *     if ({p}_step(&inputs, &{p}_defaults, &memory, &outputs) != {p}_OK) stop_safely();",
            " *",
            " * A tick with a number that is not finite leaves memory and outputs as they were. */",
        ]
        for name, struct in self.structs.items():
            lines += ["", *struct.definition(f"{p}_{name}", real, notes)]
        common = f"const {p}_inputs *inputs, const {p}_parameters *parameters"
        rows = (f' \\\n    X("{path}", {name}, {count})' for path, name, count in self.structs["parameters"].paths())
        lines += [
            "",
            "/* Of a step; BAD_INPUT: an input is not finite, NOT_FINITE: the command or the memory is not. */",
            f"enum {{ {p}_OK = 0, {p}_BAD_INPUT = 1, {p}_NOT_FINITE = 2 }};",
            "",
            "/* X(path, member, count) for each parameter, for tables that find one by its path. */",
            f"#define {p}_PARAMETERS(X)" + "".join(rows),
            "",
            f"extern const {p}_inputs {p}_zero;             /* all zero, but rotations of the reference: identity */",
            f"extern const {p}_parameters {p}_defaults;     /* as they were in Python */",
            "",
            f"void {p}_start({common}, {p}_memory *memory);",
            f"int {p}_step({common}, {p}_memory *memory, {p}_outputs *outputs);",
        ]
        if "limits.bump" in self.tick.memory.shapes:
            lines += [
                "/* With the inputs of the coming tick, where parameters change: a blend takes up the jump. */",
                f"void {p}_change({common}, const {p}_parameters *old, {p}_memory *memory);",
            ]
        return "\n".join([*lines, "", "#ifdef __cplusplus", "}", "#endif", "#endif", ""])

    def _function(self, head: str, program: Program, written: Mapping[str, tuple[str, str]]) -> list[str]:
        """A function of the blocks; `written` has the variable and struct of what it writes."""

        def place(block: str, offset: int) -> str:
            variable, struct = written.get(block, (block, block))
            return f"{variable}->{self.structs[struct].place(offset)}"

        lines = list(body(program, self.precision, place))
        text = "\n".join(lines)
        arguments = [name for name in ("inputs", "parameters", "memory") if f"const {self.prefix}_{name} *" in head]
        unused = [f"(void){name};" for name in arguments if f"{name}->" not in text]
        empty = [f"{v}->none = 0;" for v, s in written.values() if not self.structs[s]]
        return [head, "{", *(f"    {line}" for line in (*unused, *empty, *lines)), "}", ""]

    def source(self) -> str:
        """The tick, the start, and the checks around them."""
        p, real, structs = self.prefix, self.precision.real, self.structs
        common = f"const {p}_inputs *inputs, const {p}_parameters *parameters"
        lines = [
            *self._head(f"{p}.c"),
            f'#include "{p}.h"',
            "#include <math.h>",
            "#include <stddef.h>",
            "",
            "#ifdef __FAST_MATH__",
            '#error "NaN and infinity must be seen: compile without -ffast-math"',
            "#endif",
            "",
            prelude(self.precision, self.tick, self.start),
            f"const {p}_inputs {p}_zero = {structs['inputs'].initial(self._zero(), self.precision)};",
            f"const {p}_parameters {p}_defaults = {structs['parameters'].initial(self.values, self.precision)};",
            "",
            f"static int finite_numbers(const {real} *x, size_t size)",
            "{",
            "    int finite = 1;",
            "    size_t i;",
            "    for (i = 0; i < size; i++) {",
            "        finite &= x[i] - x[i] == 0;",
            "    }",
            "    return finite;",
            "}",
            "",
        ]
        tick = f"static void tick({common}, const {p}_memory *memory, {p}_memory *next, {p}_outputs *outputs)"
        lines += self._function(tick, self.tick, {"new": ("next", "memory"), "outputs": ("outputs", "outputs")})
        begin = f"void {p}_start({common}, {p}_memory *memory)"
        lines += self._function(begin, self.start, {"outputs": ("memory", "memory")})
        lines += [
            f"int {p}_step({common}, {p}_memory *memory, {p}_outputs *outputs)",
            "{",
            f"    {p}_memory next;",
            f"    {p}_outputs given;",
            f"    if (!finite_numbers((const {real} *)(const void *)inputs, sizeof *inputs / sizeof({real}))) {{",
            f"        return {p}_BAD_INPUT;",
            "    }",
            "    tick(inputs, parameters, memory, &next, &given);",
            f"    if (!finite_numbers((const {real} *)(const void *)&next, sizeof next / sizeof({real}))",
            f"        || !finite_numbers((const {real} *)(const void *)&given, sizeof given / sizeof({real}))) {{",
            f"        return {p}_NOT_FINITE;",
            "    }",
            "    *memory = next;",
            "    *outputs = given;",
            f"    return {p}_OK;",
            "}",
        ]
        if "limits.bump" in self.tick.memory.shapes:
            n = self.tick.memory.shapes["limits.bump"][0]
            lines += [
                "",
                f"void {p}_change({common}, const {p}_parameters *old, {p}_memory *memory)",
                "{",
                f"    {p}_memory before, after;",
                f"    {p}_outputs given;",
                f"    const {real} x = memory->limits.phase < 1 ? memory->limits.phase : 1;",
                "    int i;",
                "    tick(inputs, old, memory, &before, &given);",
                "    tick(inputs, parameters, memory, &after, &given);",
                f"    for (i = 0; i < {n}; i++) {{",
                "        memory->limits.bump[i] = memory->limits.bump[i] * (1 + x * x * (2 * x - 3))",
                "            + before.limits.asked[i] - after.limits.asked[i];",
                "    }",
                "    memory->limits.phase = 0;",
                "}",
            ]
        return "\n".join([*lines, ""])

    def _zero(self) -> Float64Array:
        """Inputs that are zero, but for rotations."""
        zero = self.tick.inputs.zeros()
        for view in self.tick.inputs.views(zero).values():
            if view.shape == (3, 3):
                view[...] = np.eye(3)
        return zero

    def _ticks(self) -> tuple[list[Float64Array], list[Float64Array]]:
        """Inputs near home, and the first output of each tick, by the program on plain numbers."""
        side, rng, home = self.ctrl.side, np.random.default_rng(0), snapshot(self.ctrl.arm, self.ctrl.arm.home).T()
        middles = dict.fromkeys(("q", "q_motor", "ref.q"), side.arm.home) | {"ref.p": home.p, "ref.R": home.R}
        inputs, commands, memory = [], [], None
        size = self.tick.outputs.fields[0].size
        for k in range(TICKS):
            row = self._zero()
            for path, view in self.tick.inputs.views(row).items():
                stays = view.shape == (3, 3) or path in (KNOWN, HELD) or path.endswith("given")
                view[...] = middles.get(path, view) + (0.0 if stays else 0.05) * rng.standard_normal(view.shape)
            self.tick.inputs.views(row)["t"][...] = k * side.dt
            with np.errstate(all="ignore"):
                if memory is None:
                    memory, _ = self.start.evaluated([*row, *self.values])
                outputs, memory = self.tick.evaluated([*row, *self.values, *memory])
            inputs.append(row)
            commands.append(np.array(outputs[:size], dtype=np.float64))
        return inputs, commands

    def test(self) -> str:
        """A program that runs ticks whose commands Python computed, and compares."""
        p, real = self.prefix, self.precision.real
        inputs, commands = self._ticks()
        first = self.tick.outputs.fields[0]
        scale = max(1.0, float(np.abs(commands).max()))
        rows = (self.structs["inputs"].initial(row, self.precision) for row in inputs)
        wanted = ("{" + ", ".join(x.hex() for x in row.tolist()) + "}" for row in commands)
        command = f"(const {real} *)(const void *)&outputs.{member(first.path)}"
        lines = [
            *self._head(f"{p}_test.c"),
            f'#include "{p}.h"',
            "#include <math.h>",
            "#include <stdio.h>",
            "",
            f"static const {p}_inputs given[{TICKS}] = {{",
            *(f"    {row}," for row in rows),
            "};",
            f"static const double wanted[{TICKS}][{first.size}] = {{",
            *(f"    {row}," for row in wanted),
            "};",
            "",
            "int main(void)",
            "{",
            f"    static {p}_memory memory;",
            f"    {p}_outputs outputs;",
            f"    {p}_inputs bad = given[0];",
            "    double worst = 0.0;",
            "    int k, i;",
            f"    {p}_start(&given[0], &{p}_defaults, &memory);",
            f"    for (k = 0; k < {TICKS}; k++) {{",
            f"        if ({p}_step(&given[k], &{p}_defaults, &memory, &outputs) != {p}_OK) {{",
            '            printf("tick %d gives a number that is not finite\\n", k);',
            "            return 1;",
            "        }",
            f"        for (i = 0; i < {first.size}; i++) {{",
            f"            const double error = fabs((double)({command})[i] - wanted[k][i]);",
            "            worst = error > worst ? error : worst;",
            "        }",
            "    }",
            f"    bad.q[0] = ({real})NAN;",
            f"    if ({p}_step(&bad, &{p}_defaults, &memory, &outputs) != {p}_BAD_INPUT) {{",
            '        printf("NaN in a measurement is not refused\\n");',
            "        return 1;",
            "    }",
            f'    printf("{TICKS} ticks: at most %.3g off Python, of commands up to %.3g\\n", worst, {scale!r});',
            f"    return worst <= {TOLERANCE[real] * scale!r} ? 0 : 1;",
            "}",
        ]
        return "\n".join([*lines, ""])

    def makefile(self) -> str:
        """Targets: the object, and the self-test."""
        p = self.prefix
        return f"""# {MARK} {__version__}: make test compiles the controller and compares it with Python
# SPDX-License-Identifier: Apache-2.0
CFLAGS ?= -O2
CFLAGS += -std=c99 -Wall -Wextra -Wpedantic -Wconversion

{p}.o: {p}.c {p}.h
\t$(CC) $(CFLAGS) -c {p}.c

{p}_test: {p}_test.c {p}.o
\t$(CC) $(CFLAGS) -o $@ {p}_test.c {p}.o -lm

test: {p}_test
\t./{p}_test

.PHONY: test
"""

    def cmake(self) -> str:
        """A library, and the self-test for ctest."""
        p = self.prefix
        return f"""# {MARK} {__version__}
# SPDX-License-Identifier: Apache-2.0
cmake_minimum_required(VERSION 3.13)
project({p} C)
set(CMAKE_C_STANDARD 99)
add_library({p} {p}.c)
target_include_directories({p} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
target_link_libraries({p} PUBLIC m)
enable_testing()
add_executable({p}_test {p}_test.c)
target_link_libraries({p}_test {p})
add_test(NAME {p} COMMAND {p}_test)
"""
