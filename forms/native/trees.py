# SPDX-License-Identifier: MIT
"""FFCx's trees of kernels, written with vectors: of the release that :mod:`forms._dolfinx` names.

FFCx describes a kernel as a tree before it writes C. Here the same tree is written with vectors for
what differs from cell to cell; tables, weights and constants stay numbers, which the compiler
broadcasts. Branches are computed on both sides and chosen from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, ClassVar

import ffcx.codegeneration.lnodes as tree
import ffcx.options
import numpy as np
import ufl
from ffcx.analysis import analyze_ufl_objects
from ffcx.codegeneration.backend import FFCXBackend
from ffcx.codegeneration.C.c_implementation import CFormatter
from ffcx.codegeneration.integral_generator import IntegralGenerator
from ffcx.ir.representation import compute_ir
from ufl.algorithms.analysis import extract_constants

from . import jit
from .canonical import canonical


def text(form: ufl.Form, derived: Callable[[], ufl.Form]) -> str:
    """C code of the kernels of a form that follows from another, and what they read; local."""
    made = derived()
    written = canonical(made)
    options = ffcx.options.get_options({"scalar_type": np.float64})
    with jit.handlers_kept():
        analysis = analyze_ufl_objects([written], np.float64)
        ir = compute_ir(analysis, {}, "lanes", options, False)
    bodies = {
        integral.expression.name: _Formatter().c_format(
            IntegralGenerator(integral, FFCXBackend(integral, options)).generate()
        )
        for integral in ir.integrals
    }
    (about,) = ir.forms
    names, ids = about.integral_names["cell"], about.subdomain_ids["cell"]
    order = np.argsort(ids)
    known, all_known = form.coefficients(), extract_constants(form)
    read = [written.coefficients()[i] for i in about.original_coefficient_positions]
    numbered = extract_constants(made)
    used = [numbered[c.count()] for c in written.constants()]
    head = "lanes_t *restrict A, const lanes_t *restrict w, const double *restrict c"
    head += ", const lanes_t *restrict coordinate_dofs"
    functions = [f"static void {name}({head})\n{{\n{body}}}\n" for name, body in bodies.items()]
    lists = {
        "ids": [ids[k] for k in order],
        "coefficients": [known.index(c) for c in read],
        "constants": [all_known.index(c) for c in used],
    }
    counts = [len(values) for values in lists.values()]
    tables = [f"const long lanes_{name}[] = {_braces(v)};" for name, v in lists.items()]
    return "\n".join(
        [
            '#include "cells.h"',
            *functions,
            f"const long lanes_counts[] = {_braces(counts)};",
            *tables,
            f"const lanes_kernel_t lanes_kernels[] = {_braces(names[k] for k in order)};",
            "",
        ]
    )


def _braces(values: Iterable[Any]) -> str:
    """An array of C, of at least one number."""
    return f"{{{', '.join(map(str, values)) or '0'}}}"


class _Formatter(CFormatter):
    """C with vectors for scalars, and for real numbers other than tables."""

    def __init__(self) -> None:
        super().__init__(np.float64)
        self._identities: list[str] = []  # tables of functions that are 1 at one point only

    def _dtype_to_name(self, dtype: Any) -> str:
        return "mask_t" if dtype == tree.DataType.BOOL else "lanes_t"

    def _vector(self, node: Any) -> str:
        """A value as a vector, also where all lanes have the same number."""
        return f"zero + ({self.c_format(node)})"

    def format_array_decl(self, arr: Any) -> str:
        """Tables of numbers; vectors that begin with zeros."""
        symbol, sizes = self.c_format(arr.symbol), "".join(f"[{n}]" for n in arr.sizes)
        if arr.const:
            kind = "int" if arr.symbol.dtype == tree.DataType.INT else "double"
            values = self._build_initializer_lists(arr.values)
            table = np.asarray(arr.values)
            if table.ndim == 4 and np.array_equal(table[0, 0], np.eye(table.shape[2])):
                self._identities.append(symbol)
            return f"static const {kind} {symbol}{sizes} = {values};\n"
        if arr.values is not None and np.any(arr.values):
            raise RuntimeError("an array of FFCx begins with other numbers than zeros.")
        start = "" if arr.values is None else " = {}"
        return f"{self._dtype_to_name(arr.symbol.dtype)} {symbol}{sizes}{start};\n"

    def format_variable_decl(self, v: Any) -> str:
        """A variable with its value."""
        kind = self._dtype_to_name(v.symbol.dtype)
        value = self._vector(v.value) if kind == "lanes_t" else self.c_format(v.value)
        return f"{kind} {self.c_format(v.symbol)} = {value};\n"

    def format_for_range(self, r: Any) -> str:
        """A loop; over functions of which the others vanish at the point, of one turn."""
        whole, index = super().format_for_range(r), self.c_format(r.index)
        head, _, body = whole.partition("\n")
        seen = [f"{table}[0][0][iq][{index}]" for table in self._identities]
        sums = [line for line in body.splitlines() if "=" in line]
        if seen and all(" += " in line and any(s in line for s in seen) for line in sums):
            head = f"for (int {index} = iq; {index} <= iq; ++{index})"
        return f"{head}\n{body}"

    def format_assign(self, expr: Any) -> str:
        """An assignment; sums take numbers as they are."""
        value = self._vector(expr.rhs) if expr.op == "=" else self.c_format(expr.rhs)
        return f"{self.c_format(expr.lhs)} {expr.op} {value};\n"

    def format_comparison(self, oper: Any) -> str:
        """A mask of the lanes in which a relation holds."""
        return f"(({self._vector(oper.lhs)}) {oper.op} ({self._vector(oper.rhs)}))"

    def format_logic(self, oper: Any) -> str:
        """Masks combined, bit by bit."""
        return f"(({self.c_format(oper.lhs)}) {oper.op[0]} ({self.c_format(oper.rhs)}))"

    def format_not(self, oper: Any) -> str:
        """The mask of the other lanes."""
        return f"~({self.c_format(oper.arg)})"

    def format_conditional(self, s: Any) -> str:
        """Both branches, of which each lane takes one."""
        branches = f"{self._vector(s.true)}, {self._vector(s.false)}"
        return f"lanes_choose({self.c_format(s.condition)}, {branches})"

    def format_math_function(self, c: Any) -> str:
        """A function of all lanes."""
        name = super().format_math_function(c).partition("(")[0]
        first, *others = c.args
        if name == "pow" and isinstance(others[0], tree.LiteralFloat | tree.LiteralInt):
            return f"lanes_power({self._vector(first)}, {self.c_format(others[0])})"
        return f"lanes_{name}({', '.join(self._vector(arg) for arg in c.args)})"

    c_impl: ClassVar[dict[str, Any]] = {
        **CFormatter.c_impl,
        "ArrayDecl": format_array_decl,
        "VariableDecl": format_variable_decl,
        "Assign": format_assign,
        "AssignAdd": format_assign,
        "ForRange": format_for_range,
        "MathFunction": format_math_function,
        "Conditional": format_conditional,
        "Not": format_not,
        **dict.fromkeys(("And", "Or"), format_logic),
        **dict.fromkeys(("NE", "EQ", "GE", "LE", "GT", "LT"), format_comparison),
    }
