# SPDX-License-Identifier: MIT
"""An energy psi_hat of the singular values as a symbolic function: its jet, symmetries, parameters.

psi_hat(s_1, .., s_n) is written in UFL on a stand-in for the singular values; every quantity of the
mesh in it (Constants, Functions) becomes a numbered parameter, so that the function compiled from
it knows no mesh: jet(s, p) = (psi_hat, its gradient, the upper triangle of its Hessian).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from copy import copy
from itertools import permutations
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives
from ufl.algorithms.analysis import extract_constants

from .._types import Expr
from ..differentiation import rate, with_branches_outside
from ..native import jit
from ..native.library import MAX_PARAMETERS
from .texts import NOWHERE, PROBES, text

_SAMPLES, _WIDE = 4, 40
_TOLERANCE = 1e-9  # of the checks of symmetry: far above rounding, far below a different function


class StretchFunction:
    """psi_hat(s, p) of n singular values and of parameters, with its derivatives by UFL.

    Args:
        psi_hat: Function of n UFL scalars that returns a UFL scalar [J/m^3].
        n: Number of singular values, 2 or 3.
        name: Name for messages.

    Attributes:
        parameters: UFL scalars of the mesh that psi_hat contains, in order.
        jet: UFL vector of psi_hat, its gradient (n) and Hessian (row-wise upper triangle) in terms
            of one constant vector (s_1, .., s_n, parameters).
        smooth: Whether psi_hat is unchanged when the signs of two singular values flip, as it is
            when the energy is smooth in F: then (psi_i + psi_j)/(s_i + s_j) has a limit.
        even: Whether it is unchanged when one sign flips: the same for a 3x2 gradient.

    Raises:
        ValueError: psi_hat returns no scalar, does not depend on a singular value, is not finite
            near rest, or is not symmetric in the singular values.
    """

    def __init__(self, psi_hat: Callable[..., Expr], n: int, name: str) -> None:
        self.n, self.name = n, name
        probe = PROBES[n]
        psi = with_branches_outside(expand_derivatives(text(psi_hat, n, name)))
        if psi.ufl_shape != () or psi.ufl_free_indices:
            raise ValueError(f"{name} must return a scalar, got the shape {psi.ufl_shape}.")
        if probe not in extract_constants(psi):
            raise ValueError(f"{name} does not depend on the singular values, got {psi}.")
        leaves = _leaves(psi, probe)
        self.parameters = [c for leaf in leaves for c in _components(leaf)]
        if len(self.parameters) > MAX_PARAMETERS:
            raise ValueError(
                f"{name} may have {MAX_PARAMETERS} parameters, got {len(self.parameters)}."
            )
        self._constants = ufl.Constant(NOWHERE, shape=(n + len(self.parameters),))
        c = self._constants
        s = ufl.variable(ufl.as_vector([c[i] for i in range(n)]))
        stand_ins: dict[Expr, Expr] = {probe: s}
        start = n
        for leaf in leaves:
            size = int(np.prod(leaf.ufl_shape, dtype=int))
            entries = np.array([c[start + k] for k in range(size)], dtype=object)
            shaped = entries.reshape(leaf.ufl_shape).tolist() if leaf.ufl_shape else entries[0]
            stand_ins[leaf] = ufl.as_tensor(shaped) if leaf.ufl_shape else shaped
            start += size
        self._s, self._psi = s, ufl.replace(psi, stand_ins)
        self._check_symmetry([v for leaf in leaves for v in _known_values(leaf)])
        self._derive()

    def _derive(self) -> None:
        n, s = self.n, self._s
        g = ufl.diff(self._psi, s)
        H = ufl.diff(g, s)
        upper = [H[i, j] for i in range(n) for j in range(i, n)]
        self.jet = ufl.as_vector([self._psi, *(g[i] for i in range(n)), *upper])
        flips = [(i, j) for i in range(n) for j in range(i + 1, n)]
        self.smooth = all(self._unchanged(_flip(*pair)) for pair in flips)
        self.even = all(self._unchanged(_flip(i)) for i in range(n))
        self._compiled: tuple[Any, Any] | None = None
        self._by_parameter: dict[int, StretchFunction] = {}

    def by_parameter(self, k: int) -> StretchFunction:
        """The function d psi_hat / d p_k of the same singular values and parameters."""
        if k not in self._by_parameter:
            other = copy(self)
            along = [ufl.as_ufl(i == self.n + k) for i in range(self.n + len(self.parameters))]
            other._psi = expand_derivatives(rate(self._psi, self._constants, ufl.as_vector(along)))
            other._derive()
            self._by_parameter[k] = other
        return self._by_parameter[k]

    def __call__(self, s: NDArray[np.float64], parameters: NDArray | None = None) -> float:
        """Value, for the sampled parameters by default; NaN where it is not a real number."""
        values = np.concatenate([s, self._sample if parameters is None else parameters])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                value = self._psi((), mapping={self._constants: values})
        except (ValueError, ZeroDivisionError, OverflowError):
            return np.nan
        return float(value) if np.isreal(value) else np.nan

    def compiled(self, comm: MPI.Comm) -> tuple[Any, Any]:
        """FFCx's kernel of the jet and the module it lives in. Collective at the first call."""
        if comm.size > 1:  # a cache that ranks might see differently would let one wait for ever
            return jit.compiled(comm, (self.jet, np.zeros((1, 1))))[:2]
        if self._compiled is None:
            self._compiled = jit.compiled(comm, (self.jet, np.zeros((1, 1))))[:2]
        return self._compiled

    def _states(self) -> NDArray[np.float64]:
        return np.random.default_rng(2).uniform(0.8, 1.25, (_SAMPLES, self.n))

    def _check_symmetry(self, known: list[float | None]) -> None:
        states = self._states()
        # Drawn parameters, because a Constant that is 0 now may hide a term; present values where
        # psi_hat has none for the drawn ones.
        drawn = np.random.default_rng(1).uniform(0.5, 1.5, len(known))
        present = [d if v is None else v for v, d in zip(known, drawn, strict=True)]
        for self._sample in (drawn, np.array(present)):
            values = np.array([self(s) for s in states])
            if np.all(np.isfinite(values)):
                break
        else:
            bad = states[int(np.argmin(np.isfinite(values)))]
            raise ValueError(
                f"{self.name} must be finite near rest, got {self(bad)} at the singular values "
                f"{np.round(bad, 3).tolist()}."
            )
        for s, value in zip(states, values, strict=True):
            for order in permutations(range(self.n)):
                other = self(np.take(s, order))
                if not abs(other - value) <= _TOLERANCE * max(abs(value), abs(other), 1e-300):
                    raise ValueError(
                        f"{self.name} must not depend on the order of the singular values, got "
                        f"{value:.6g} at {np.round(s, 3).tolist()} and {other:.6g} with them in "
                        f"the order {[i + 1 for i in order]}: an isotropic energy is symmetric in "
                        "them."
                    )

    def _unchanged(self, flip: Callable[[NDArray], NDArray]) -> bool:
        """Whether a change of signs leaves psi_hat alone, near rest and far from it.

        Far from it, because a term may begin at a stretch, or where a parameter says so.
        """
        rng = np.random.default_rng(3)
        states = [(s, self._sample) for s in self._states()]
        for _ in range(_WIDE):
            s = np.exp(rng.uniform(np.log(0.05), np.log(20), self.n))
            drawn = np.exp(rng.uniform(np.log(0.05), np.log(20), len(self._sample)))
            states += [(s, self._sample), (s, drawn)]
        seen = False
        for s, parameters in states:
            a, b = self(s, parameters), self(flip(s), parameters)
            if not np.isfinite(a) or (not np.isfinite(b) and seen):
                continue
            if not abs(a - b) <= _TOLERANCE * max(abs(a), abs(b)):
                return False
            seen = True
        return seen


def _flip(*which: int) -> Callable[[NDArray], NDArray]:
    def flipped(s: NDArray) -> NDArray:
        out = s.copy()
        out[list(which)] *= -1
        return out

    return flipped


def _leaves(psi: Expr, probe: Expr) -> list[Expr]:
    """Quantities of the mesh in psi: terminals with values, and derivatives as a whole."""
    found: dict[Expr, None] = {}
    stack = [psi]
    seen = set()
    while stack:
        e = stack.pop()
        if id(e) in seen:
            continue
        seen.add(id(e))
        if isinstance(e, ufl.classes.Derivative):
            found[e] = None
        elif isinstance(e, ufl.classes.Variable) and probe not in extract_constants(e):
            found[e] = None  # whole: a parameter in F itself must be seen to depend on it
        elif e._ufl_is_terminal_:
            number = (ufl.classes.ConstantValue, ufl.classes.MultiIndex, ufl.classes.Label)
            if e is not probe and not isinstance(e, number):
                found[e] = None
        else:
            stack.extend(reversed(e.ufl_operands))
    # UFL sorts operands by their names as words, c_10 before c_9: in the order of their numbers the
    # compiled text does not depend on how many there were before.
    return sorted(found, key=_number)


def _number(leaf: Expr) -> int:
    counted = isinstance(leaf, ufl.classes.Constant | ufl.classes.Coefficient)
    return leaf.count() if counted else -1


def _components(leaf: Expr) -> list[Expr]:
    return [leaf[i] for i in np.ndindex(leaf.ufl_shape)] if leaf.ufl_shape else [leaf]


def _known_values(leaf: Expr) -> list[float | None]:
    """Values of a Constant, alike on all ranks; None for what varies in space."""
    if isinstance(leaf, fem.Constant):
        return [float(v) for v in np.asarray(leaf.value).ravel()]
    return [None] * int(np.prod(leaf.ufl_shape, dtype=int))
