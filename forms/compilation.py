# SPDX-License-Identifier: MIT
"""From a UFL form with operators to a DOLFINx form whose kernels compute them in the cell loop.

In each integral the jets become coefficients on the points of its quadrature rule, which FFCx
compiles as it does any other; the kernel that DOLFINx calls fills them in for one cell and passes
them on (kernels/cell.h). Nothing is kept per quadrature point.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass, field
from typing import Any

import basix
import basix.ufl
import numpy as np
import ufl
from basix.ufl import _QuadratureElement
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.algorithms.analysis import extract_constants

from . import _dolfinx
from .differentiation import expanded, nodes
from .entities import with_owned_entities
from .native import jit
from .native.library import KERNELS, MAX_OPERATORS, MAX_PIECES, library, pointer
from .operators.evaluate import describe
from .operators.jets import Jet, Jets
from .quadrature import default_degree, with_quadrature

STACK = 4 * 2**20  # bytes of a cell's values: they lie on the stack, of which most systems have 8

_TYPES = {"cell": fem.IntegralType.cell, "exterior_facet": fem.IntegralType.exterior_facet}


def compiled(form: ufl.Form, project: bool = False) -> fem.Form:
    """Compile a form, with or without energies in singular values. Collective.

    Args:
        form: Functional, linear or bilinear form. Integrals without a quadrature degree get that
            of :func:`forms.quadrature.with_quadrature`.
        project: Make the tangent positive semi-definite: second derivatives of operators at each
            point, and the matrices of cells and facets where other terms take part.

    Raises:
        ValueError: an operator in an integral over interior facets, a rule other than the default,
            or a measure that lists entities which the mesh does not have.
        RuntimeError: the compiler is missing or failed.
    """
    form = expand_derivatives(expanded(form))
    if form.empty():
        raise ValueError("the form is zero: does it depend on what it was differentiated by?")
    form = with_quadrature(with_owned_entities(form))
    jets = [c for c in form.coefficients() if isinstance(c, Jet)]
    if not jets and not project:
        return _plain(form)
    return _Lowering(form, project).form()


def pointwise(form: ufl.Form) -> fem.Form:
    """Kernels of a form that is linear in values at the points of its rule. Collective.

    As :func:`compiled`, but of a test function on a space that has no degrees of freedom of
    DOLFINx: what is returned holds kernels, entities and coefficients, and is never assembled.

    Args:
        form: Expanded, with quadrature degrees, its test function on a quadrature element.
    """
    return _Lowering(form, project=False, assembled=False).form()


def _plain(form: ufl.Form) -> fem.Form:
    """DOLFINx's own form, and the addresses of its kernels."""
    result: Any = jit.form(form)
    ufcx, ffi = result.ufcx_form, result.module.ffi
    integrals = [ufcx.form_integrals[k] for k in range(ufcx.form_integral_offsets[len(_TYPES)])]
    vars(result)["_kernels"] = [_address(ffi, i.tabulate_tensor_float64) for i in integrals]
    return result


@dataclass
class _Rule:
    """Points that operators of one integral live on, and the coefficients that stand for them."""

    kind: str
    degree: int
    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    stand_ins: dict[Jet, ufl.Coefficient] = field(default_factory=dict)

    def stand_in(self, jet: Jet) -> ufl.Coefficient:
        """Coefficient with a value at each point of the rule."""
        if jet not in self.stand_ins:
            domain = ufl.domain.extract_unique_domain(jet)
            self.stand_ins[jet] = ufl.Coefficient(
                ufl.FunctionSpace(domain, self._element(domain, jet.ufl_shape))
            )
        return self.stand_ins[jet]

    def _element(self, domain: Any, shape: tuple[int, ...]) -> Any:
        cell = getattr(basix.CellType, _dolfinx.cell_name(domain.ufl_cell()))
        if self.kind == "cell":
            scalar = basix.ufl.quadrature_element(cell, degree=self.degree)
        else:
            scalar = _FacetPoints(cell, self.points, self.weights)
        return basix.ufl.blocked_element(scalar, shape=shape) if shape else scalar


class _FacetPoints(_QuadratureElement):
    """Values at the points of a rule on the reference facet, for integrals over facets.

    FFCx integrates with the points and weights of such an element.
    """

    def __init__(
        self, cell: basix.CellType, points: NDArray[np.float64], weights: NDArray[np.float64]
    ) -> None:
        super().__init__(cell, points, weights, ufl.identity_pullback, degree=0)
        rule = (points.tolist(), weights.tolist())
        self._repr = f"FacetPoints({cell.name}, {rule!r})"  # in full: it is part of the cache's key

    def tabulate(self, nderivs: int, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The identity: FFCx maps the facet's points into the cell, one after the other."""
        if nderivs or len(points) != len(self._points):
            raise ValueError("an operator on facets is known at its own points only.")
        return np.eye(len(points))[None]


@dataclass
class _Operand:
    """Operand and parameters of one operator at the points of one rule, compiled."""

    jets: Jets
    rule: _Rule
    kernel: Any
    coefficients: list[Any]
    constants: list[Any]


class _Lowering:
    """One form on its way to DOLFINx."""

    def __init__(self, form: ufl.Form, project: bool, assembled: bool = True) -> None:
        self.domain = form.ufl_domain()
        self.mesh = _dolfinx.cpp_mesh(self.domain)
        self.comm = self.mesh.comm
        self.project = project and len(form.arguments()) == 2
        self.arguments, self.assembled = form.arguments(), assembled
        self.given = form
        self.rules: dict[tuple[str, int], _Rule] = {}
        self.pure: dict[tuple[str, int], bool] = {}
        # The stand-ins are created after the form's coefficients and so come after them.
        self.lowered = ufl.Form([self._replaced(integral) for integral in form.integrals()])
        stand_ins = {s for rule in self.rules.values() for s in rule.stand_ins.values()}
        needed = 8 * sum(map(_size, stand_ins))
        if needed > STACK:
            raise ValueError(
                f"the form needs {needed / 2**20:.1f} MiB per cell for its energies in singular "
                f"values, more than {STACK // 2**20}: lower the quadrature degree."
            )
        self.lib, self.ffi = library(self.comm)
        self.ufcx, module, self.lowered = jit.compiled(self.comm, self.lowered)
        self.keep: list[Any] = [self.lib, self.ffi, module]
        everything = self.lowered.coefficients()
        positions = [
            self.ufcx.original_coefficient_positions[i] for i in range(self.ufcx.num_coefficients)
        ]
        self.ordered = [everything[i] for i in positions]
        self.packed = [c for c in self.ordered if c not in stand_ins]
        if self.ordered[: len(self.packed)] != self.packed:
            raise RuntimeError("FFCx put an operator's values before the form's coefficients.")
        self.constants = list(self.lowered.constants())
        for c in [*self.packed, *self.constants]:
            if not hasattr(c, "_cpp_object"):
                raise ValueError(
                    f"{c} has no value: use a Function or Constant of DOLFINx, not UFL's own."
                )
        self.operands = [
            self._operand(jets, rule)
            for rule in self.rules.values()
            for jets in dict.fromkeys(jet.jets for jet in rule.stand_ins)
        ]
        # What DOLFINx packs: the form's own coefficients, then those of operands only.
        extra = [c for o in self.operands for c in o.coefficients]
        self.real = list(dict.fromkeys([*self.packed, *extra]))

    def _replaced(self, integral: Any) -> Any:
        integrand = integral.integrand()
        jets = [c for c in extract_coefficients(integrand) if isinstance(c, Jet)]
        if self.project:
            self._note_purity(integral, jets)
        if not jets:
            return integral
        integral = integral.reconstruct(metadata=self._metadata(integral, jets))
        rule = self._rule(integral)
        mapping = {jet: rule.stand_in(jet) for jet in jets}
        return integral.reconstruct(integrand=ufl.replace(integrand, mapping))

    def _note_purity(self, integral: Any, jets: list[Jet]) -> None:
        """Whether all terms of an integral are second derivatives of operators, and only those."""
        second = {jet: ufl.classes.Zero(jet.ufl_shape) for jet in jets}
        rest = ufl.replace(integral.integrand(), second)
        pure = all(jet.level == 2 for jet in jets) and isinstance(rest, ufl.classes.Zero)
        # A factor might be negative: only where nothing but positive numbers can be one.
        terminals = [e for e in nodes(integral.integrand()) if e._ufl_is_terminal_]
        factors = (ufl.classes.Coefficient, ufl.classes.Constant, ufl.classes.GeometricQuantity)
        pure &= not any(isinstance(e, factors) and e not in jets for e in terminals)
        numbers = [float(e) for e in terminals if isinstance(e, ufl.classes.ScalarValue)]
        pure &= all(value >= 0 for value in numbers)
        for number in _numbers(integral.subdomain_id()):
            key = (integral.integral_type(), number)
            self.pure[key] = self.pure.get(key, True) and pure

    def _metadata(self, integral: Any, jets: list[Jet]) -> dict[str, Any]:
        """The integral's metadata with a quadrature degree."""
        functions = [c for jet in jets for c in extract_coefficients(jet.jets.packed)]
        degree = max((c.ufl_element().embedded_superdegree for c in functions), default=1)
        default = default_degree(integral.integral_type(), max(degree, 1))
        given = integral.metadata().get("quadrature_degree")
        chosen = given if isinstance(given, int) and given >= 0 else default
        return {**integral.metadata(), "quadrature_degree": chosen}

    def _rule(self, integral: Any) -> _Rule:
        kind, metadata = integral.integral_type(), integral.metadata()
        if kind not in _TYPES:
            raise ValueError(
                "an energy in singular values can be integrated over cells and exterior facets, "
                f"got an integral of type {kind}."
            )
        scheme, degree = metadata.get("quadrature_rule", "default"), metadata["quadrature_degree"]
        if scheme != "default":
            raise ValueError(
                "an energy in singular values is integrated by the default rule, got "
                f"{scheme}: leave the rule out and choose the degree, as in dx(degree=2)."
            )
        if (kind, degree) not in self.rules:
            cell = getattr(basix.CellType, _dolfinx.cell_name(self.domain.ufl_cell()))
            if kind == "exterior_facet":
                cell = basix.cell.subentity_types(cell)[-2][0]
            self.rules[kind, degree] = _Rule(kind, degree, *basix.make_quadrature(cell, degree))
        return self.rules[kind, degree]

    def _operand(self, jets: Jets, rule: _Rule) -> _Operand:
        kernel, module, packed = jit.compiled(
            self.comm, (expand_derivatives(jets.packed), rule.points)
        )
        self.keep.append(module)
        coefficients = extract_coefficients(packed)
        for c in coefficients:
            if (
                not isinstance(c, fem.Function)
                or ufl.domain.extract_unique_domain(c) != self.domain
            ):
                raise ValueError(
                    f"{c} in the operand or a parameter of {jets.kind.function.name} is no "
                    "Function of the mesh that the form is integrated over."
                )
        positions = [
            kernel.original_coefficient_positions[i] for i in range(kernel.num_coefficients)
        ]
        ordered = [coefficients[i] for i in positions]
        return _Operand(jets, rule, kernel, ordered, list(extract_constants(packed)))

    def form(self) -> fem.Form:
        """The DOLFINx form."""
        offsets = self.ufcx.form_integral_offsets
        found = [
            (kind, self.ufcx.form_integral_ids[index], self.ufcx.form_integrals[index])
            for number, kind in enumerate(_TYPES)
            for index in range(offsets[number], offsets[number + 1])
        ]
        elsewhere = [i for i in self.lowered.integrals() if i.integral_type() not in _TYPES]
        if len(found) > KERNELS or elsewhere:
            what = "projected form" if self.project else "form with energies in singular values"
            raise ValueError(
                f"a {what} may have {KERNELS} integrals, over cells and exterior facets, got "
                f"{len(found)} of those and {len(elsewhere)} others: use a coefficient that varies "
                "by region instead of regions."
            )
        records = self.ffi.new("integral_t[]", len(found))
        for k, (kind, number, integral) in enumerate(found):
            self._fill(records[k], kind, number, integral)
        first = self.lib.integrals_add(records, len(found))
        if first < 0:
            raise MemoryError("no memory for the operators' kernels.")
        integrals: dict[Any, Any] = {}
        for k, (kind, number, _) in enumerate(found):
            entities = _dolfinx.integration_entities(
                self.mesh, _TYPES[kind], subdomain(self.given, kind), number
            )
            integrals.setdefault(_TYPES[kind], []).append(
                (_address(self.ffi, self.lib.kernels[k]), entities, len(self.real))
            )
        form = _dolfinx.custom_form(
            self.mesh,
            [a.ufl_function_space() for a in self.arguments if self.assembled],
            integrals,
            self.real,
            [fem.Constant(self.domain, np.float64(first)), *self._all_constants()],
            any(integral.needs_facet_permutations for *_, integral in found),
        )
        vars(form)["_operators"] = self.keep  # the kernels' modules live as long as the form
        kernels = [address for kind in _TYPES.values() for address, *_ in integrals.get(kind, ())]
        vars(form)["_kernels"] = kernels
        weakref.finalize(form, self.lib.integrals_release, first, len(found))
        return form

    def _all_constants(self) -> list[Any]:
        return [*self.constants, *(c for o in self.operands for c in o.constants)]

    def _fill(self, record: Any, kind: str, number: int, integral: Any) -> None:
        """Describe one integral to the kernels."""
        record.form = pointer(self.ffi, integral.tabulate_tensor_float64)
        record.packed = sum(map(_size, self.packed))
        record.coefficients = sum(map(_size, self.ordered))
        starts = dict(zip(self.ordered, np.cumsum([0, *map(_size, self.ordered)]), strict=False))
        enabled = {c for i, c in enumerate(self.ordered) if integral.enabled_coefficients[i]}
        if self.project:
            record.project_points = self.pure[kind, number]
            if not record.project_points:
                record.project_rows = _size(self.arguments[0])
        constants = 1 + sum(_length(c) for c in self.constants)
        used = []
        for operand in self.operands:
            rule = operand.rule
            levels = {
                jet.level: starts[stand_in]
                for jet, stand_in in rule.stand_ins.items()
                if jet.jets is operand.jets and stand_in in enabled
            }
            if rule.kind == kind and levels:
                used.append((operand, levels, constants))
            constants += sum(_length(c) for c in operand.constants)
        if len(used) > MAX_OPERATORS:
            raise ValueError(
                f"one integral may have {MAX_OPERATORS} energies in singular values at different "
                f"operands, got {len(used)}: write their sum as several integrals."
            )
        record.jets = len(used)
        for jet, what in zip(record.jet, used, strict=False):
            self._fill_jet(jet, *what)

    def _fill_jet(
        self, record: Any, operand: _Operand, levels: dict[int, int], constants: int
    ) -> None:
        function = operand.jets.kind.function
        kernel, module = function.compiled(self.comm)
        self.keep.append(module)
        describe(self.ffi, record.op, operand.jets.kind, kernel)
        record.operand = pointer(self.ffi, operand.kernel.tabulate_tensor_float64)
        record.points = len(operand.rule.points)
        record.constants = constants
        record.levels = [levels.get(level, -1) for level in range(3)]
        sizes = [_size(c) for c in operand.coefficients]
        starts = dict(zip(self.real, np.cumsum([0, *map(_size, self.real)]), strict=False))
        if len(sizes) > MAX_PIECES:
            raise ValueError(
                f"the operand and the parameters of {function.name} may contain {MAX_PIECES} "
                f"functions, got {len(sizes)}."
            )
        record.coefficients, record.pieces = sum(sizes), len(sizes)
        position = 0
        for k, (c, size) in enumerate(zip(operand.coefficients, sizes, strict=True)):
            record.piece[k] = [position, starts[c], size]
            position += size


def subdomain(form: ufl.Form, kind: str) -> Any:
    """Tags of a form's integrals of a type; None where they have none.

    Raises:
        ValueError: several sets of them.
    """
    listed = form.subdomain_data()[form.ufl_domain()].get(kind, ())
    different = {id(d): d for d in listed if d is not None}
    if len(different) > 1:
        raise ValueError(
            f"the form has {len(different)} different sets of tags for its {kind} integrals: "
            "take all measures from one body, or one ufl.Measure."
        )
    return next(iter(different.values()), None)


def _numbers(subdomain_id: Any) -> list[int]:
    ids = subdomain_id if isinstance(subdomain_id, tuple) else (subdomain_id,)
    return [i if isinstance(i, int) else -1 for i in ids]


def _size(c: Any) -> int:
    return int(c.ufl_element().dim)


def _length(constant: Any) -> int:
    return int(np.prod(constant.ufl_shape, dtype=int))


def _address(ffi: Any, pointer: Any) -> int:
    return int(ffi.cast("uintptr_t", pointer))
