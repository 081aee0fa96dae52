# SPDX-License-Identifier: MIT
"""Any energy outside a mesh: psi, P = dpsi/dF and dP/dF at arrays of deformation gradients."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from numbers import Real
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import ArrayLike, NDArray
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.corealg.traversal import unique_post_traversal

from ._checks import in_ufl, numbers_of
from ._types import Expr
from .differentiation import diff, expanded
from .native import jit
from .operators.energy import SingularValueEnergy
from .operators.evaluate import evaluate as kernels
from .operators.jets import Jet, Jets, Kind
from .operators.texts import NOWHERE, fingerprint

Array = NDArray[np.float64]

KEPT = 64  # energies whose code stays at hand; more are looked up in the cache on disk
FIRST, AFTER = 10**6, 10**5  # numbers of Constants that stand for others; of values of operators
_made: dict[tuple, _Code] = {}


def evaluate(
    energy: Callable[..., Expr],
    F: ArrayLike,
    *args: Any,
    derivatives: int = 2,
    **parameters: Any,
) -> tuple[Array, ...]:
    """Energy density, stress and tangent of any energy at arrays of F; local.

    psi(F),  P = dpsi/dF,  A_ijkl = d2psi / dF_ij dF_kl

    ``evaluate(forms.energies.yeoh, F, 0.5, -0.02, 0.005)``. The derivatives are UFL's, and those of
    the compiled kernels for energies in singular values, exact for equal ones. Numbers and arrays
    may change without another compilation; the code is made once per energy.

    Args:
        energy: Function psi(F, **parameters) in UFL, as those of :mod:`forms.energies` or your own.
        F: Deformation gradients, shape (n, 3, 3), or (3, 3) for one; of a sheet (n, 3, 2).
        *args: Parameters in order: numbers; arrays with an entry per F, shape (n,), (n, 3) for a
            fiber or (n, 3, 3) for an activation; tuples and lists of numbers as the energy takes
            them, for a fiber that is the same everywhere; UFL vectors; Constants, at their values.
        derivatives: 0 for psi alone, 1 for psi and P, 2 for all three.
        **parameters: Parameters by name.

    Returns:
        psi [J/m^3], shape (n,), P [Pa], the shape of F, and A [Pa], shape (n, 3, 3, 3, 3); without
        the n for one F.

    Raises:
        ValueError: another shape, entries that are not finite, parameters that vary in space, or an
            energy that returns no scalar of F.
    """
    name = getattr(energy, "__name__", type(energy).__name__).replace("<lambda>", "the energy")
    if not callable(energy) or isinstance(energy, ufl.core.expr.Expr):
        raise ValueError(
            "evaluate needs an energy as a function psi(F, ...), got "
            f"{type(energy).__name__}: pass forms.energies.neo_hookean, not what it returns."
        )
    if derivatives not in (0, 1, 2):
        raise ValueError(f"derivatives must be 0, 1 or 2, got {derivatives}.")
    arrays = numbers_of(F, "F", name)
    if arrays.ndim not in (2, 3) or arrays.shape[-2:] not in ((3, 3), (3, 2), (2, 2)):
        raise ValueError(f"{name} needs F of shape (n, 3, 3) or (3, 3), got {arrays.shape}.")
    if not np.all(np.isfinite(arrays)):
        raise ValueError(f"{name} needs finite F, got {int(np.sum(~np.isfinite(arrays)))} others.")
    one = arrays.ndim == 2
    arrays = arrays[None] if one else arrays
    if isinstance(energy, SingularValueEnergy):
        found = [energy.energy(arrays, *args, **parameters)]
        if derivatives:
            found += energy.evaluate(arrays, *args, **parameters)[:derivatives]
    else:
        given = _Given(len(arrays), one, name)
        found = _evaluated(energy, arrays, args, parameters, derivatives, given)
    return tuple(values[0] if one else values for values in found)


def _evaluated(
    energy: Callable[..., Expr],
    arrays: Array,
    args: Any,
    parameters: Any,
    derivatives: int,
    given: _Given,
) -> list[Array]:
    C = _constant(0, arrays.shape[1:])
    F = ufl.variable(C)

    def written(numbers: bool) -> Expr:
        given.values = {C: arrays}
        psi = in_ufl(
            energy,
            given.name,
            F,
            *(given(f"parameter {k + 1}", v, numbers) for k, v in enumerate(args)),
            **{key: given(key, v, numbers) for key, v in parameters.items()},
        )
        psi = ufl.as_ufl(psi)
        if psi.ufl_shape != () or psi.ufl_free_indices:
            raise ValueError(f"{given.name} must return a scalar, got the shape {psi.ufl_shape}.")
        return psi

    # With the numbers themselves first, which the energy may check or branch by.
    psi = written(numbers=True)
    if given.numbers:
        try:
            psi = written(numbers=False)
        except Exception:  # whatever an energy says that wants to see a number
            psi = written(numbers=True)
    if C not in extract_constants(psi):
        raise ValueError(f"{given.name} does not depend on F, got {psi}.")
    leaves = [given.value(leaf) for leaf in _leaves(psi)]
    said = derivatives, C, _said(psi)
    code = _made.pop(said, None) or _Code(psi, F, derivatives)
    _made[said] = code  # the last one used comes last
    while len(_made) > KEPT:
        del _made[next(iter(_made))]
    return code(leaves, len(arrays))


class _Given:
    """Parameters as UFL has them, and the values of those that stand for numbers.

    Args:
        n: Number of deformation gradients.
        one: Whether there is one alone, whose arrays have no axis for it.
        name: The energy's name.
    """

    def __init__(self, n: int, one: bool, name: str) -> None:
        self.n, self.one, self.name = n, one, name
        self.numbers = False  # whether one has been met
        self.values: dict[Expr, Array] = {}

    def __call__(self, key: str, value: Any, numbers: bool) -> Any:
        """One parameter: itself, or Constants that stand for its numbers."""
        if isinstance(value, bool | np.bool_):
            return value
        if isinstance(value, Real):
            _finite(np.asarray(value, float), key, self.name)
            self.numbers = True
            return value if numbers else self._stand_in(np.full((self.n,), float(value)))
        if isinstance(value, tuple | list):
            entries = [self(key, entry, numbers) for entry in value]
            return entries if isinstance(value, list) else tuple(entries)
        if not isinstance(value, np.ndarray):
            return value
        array = _finite(numbers_of(value, key, self.name), key, self.name)
        array = array[None] if self.one else array
        if array.ndim == 0 or len(array) != self.n:
            raise ValueError(
                f"{self.name} needs {key} as an array with an entry per F, {self.n} of them, got "
                f"the shape {value.shape}: pass a tuple for a vector that is the same everywhere."
            )
        return self._stand_in(array)

    def _stand_in(self, array: Array) -> Expr:
        constant = _constant(len(self.values), array.shape[1:])
        self.values[constant] = array
        return constant

    def value(self, leaf: Expr) -> Array:
        """Values of a Constant at each F, shape (n, size)."""
        if leaf in self.values:
            return self.values[leaf].reshape(self.n, -1)
        if not isinstance(leaf, fem.Constant):
            raise ValueError(
                f"{self.name} contains {leaf}, which has no value outside a mesh: pass numbers, or "
                "an array with an entry per F."
            )
        return np.broadcast_to(np.asarray(leaf.value, float).ravel(), (self.n, leaf.value.size))


class _Code:
    """Compiled code of an energy and its derivatives.

    Args:
        psi: Energy in terms of Constants.
        F: The variable it is differentiated by.
        derivatives: Highest derivative.
    """

    def __init__(self, psi: Expr, F: Expr, derivatives: int) -> None:
        # Constants of a mesh, too, become Constants of no mesh.
        own = {
            leaf: _constant(2 * AFTER + k, leaf.ufl_shape) for k, leaf in enumerate(_leaves(psi))
        }
        own = {leaf: new for leaf, new in own.items() if isinstance(leaf, fem.Constant)}
        self._leaves = [own.get(leaf, leaf) for leaf in _leaves(psi)]
        psi = ufl.replace(psi, own)
        levels = [expanded(psi)]
        for _ in range(derivatives):
            levels.append(diff(levels[-1], F))
        self._shapes = [level.ufl_shape for level in levels]
        indices = [(level, index) for level in levels for index in np.ndindex(level.ufl_shape)]
        entries = [level[index] if index else level for level, index in indices]
        together = expand_derivatives(ufl.as_vector(entries))
        jets = [c for c in extract_coefficients(together) if isinstance(c, Jet)]
        self._stand_ins = {jet: _constant(AFTER + k, jet.ufl_shape) for k, jet in enumerate(jets)}
        self._operands = {jet.jets: _Kernel(expand_derivatives(jet.jets.packed)) for jet in jets}
        self._kernel = _Kernel(ufl.replace(together, self._stand_ins))

    def __call__(self, leaves: list[Array], n: int) -> list[Array]:
        """Values and derivatives, for values of the Constants in the order of the text."""
        known = dict(zip(self._leaves, leaves, strict=True))
        for jets, operand in self._operands.items():
            known |= self._jets(jets, operand(known, n))
        out = self._kernel(known, n)
        ends = np.cumsum([np.prod(shape, dtype=int) for shape in self._shapes])
        parts = np.split(out, ends[:-1], axis=1)
        return [p.reshape(n, *s) for p, s in zip(parts, self._shapes, strict=True)]

    def _jets(self, jets: Jets, X: Array) -> dict[Expr, Array]:
        found = {jet.level: s for jet, s in self._stand_ins.items() if jet.jets is jets}
        values = kernels(jets.kind, X, tuple(found))
        return {s: v.reshape(len(X), -1) for s, v in zip(found.values(), values, strict=True)}


class _Kernel:
    """FFCx's kernel of a UFL vector of Constants, called for one set of values after another."""

    def __init__(self, expression: Expr) -> None:
        self._ufcx, self._module, written = jit.compiled(
            MPI.COMM_SELF, (expression, np.zeros((1, 1)))
        )
        # The canonical expression numbers the Constants of the given one in their order.
        original = extract_constants(expression)
        self._constants = [original[c.count()] for c in extract_constants(written)]
        (self._size,) = expression.ufl_shape

    def __call__(self, known: dict[Expr, Array], n: int) -> Array:
        columns = [known[c] for c in self._constants] or [np.empty((n, 0))]
        given = np.ascontiguousarray(np.column_stack(columns), dtype=np.float64)
        out, x = np.zeros((n, self._size)), np.zeros(6)
        ffi = self._module.ffi
        kernel = self._ufcx.tabulate_tensor_float64
        A, c = (ffi.cast("double *", a.ctypes.data) for a in (out, given))
        place, width = ffi.cast("double *", x.ctypes.data), given.shape[1]
        rest = [ffi.NULL] * (len(ffi.typeof(kernel).args) - 4)
        for k in range(n):
            kernel(A + k * self._size, ffi.NULL, c + k * width, place, *rest)
        return out


def _constant(k: int, shape: tuple[int, ...]) -> Expr:
    """Stands for F (0), and for the k-th set of numbers of any energy, in every process the same.

    Its number is far above those that UFL gives.
    """
    return ufl.Constant(NOWHERE, shape=shape, count=FIRST + k)


def _leaves(psi: Expr) -> Iterator[Expr]:
    """Terminals whose values an energy takes, in the order of its text."""
    numbers = (ufl.classes.ConstantValue, ufl.classes.MultiIndex, ufl.classes.Label)
    for e in unique_post_traversal(psi):
        if e._ufl_is_terminal_ and not isinstance(e, numbers) and not hasattr(e, "kind"):
            yield e


def _said(psi: Expr) -> tuple[Any, ...]:
    """What a text says, whichever Constants of a mesh and whichever equal operators are in it."""
    order: dict[Expr, int] = {}

    def known(node: Any) -> Any:
        kind: Kind | None = getattr(node, "kind", None)
        if kind is not None:
            psi_hat = tuple(map(known, fingerprint(kind.function.jet)))
            return psi_hat, kind.shape, kind.plane, kind.improper, kind.clamp
        if isinstance(node, ufl.classes.Constant):
            return "constant", order.setdefault(node, len(order)), node.ufl_shape
        return node

    return tuple(map(known, fingerprint(psi)))


def _finite(array: Array, key: str, name: str) -> Array:
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name} needs a finite {key}, got {array.tolist()}.")
    return array
