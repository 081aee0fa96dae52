# SPDX-License-Identifier: MIT
"""Energies given by a function psi_hat of the singular values."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable
from math import isfinite
from numbers import Real
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import ArrayLike, NDArray

from .._checks import numbers_of
from .._types import Expr
from .evaluate import evaluate
from .jets import Kind, is_plane, singular_value_function
from .stretches import StretchFunction
from .texts import fingerprint, stand_in, text

Array = NDArray[np.float64]

STRETCHES = ("s1", "s2", "s3")
TEXTS = 16  # that an energy remembers: one for each length of its lists, and each change of psi_hat


class SingularValueEnergy:
    """An isotropic energy density psi(F) = psi_hat(s1, s2, s3), right for every F.

    Called with a deformation gradient it is a UFL scalar for any integrand, whose derivatives are
    P = U diag(psi_i) V^T and the dP/dF of document 000; :meth:`evaluate` gives the same in NumPy.
    The singular values are signed: F = U diag(s) V^T with rotations U and V, s1 >= s2 >= |s3|, and
    s3 < 0 where F is inverted. An F of a plane or axisymmetric body has those of its 2x2 block and
    the out-of-plane stretch F33 as third.

    Args:
        psi_hat: Function of UFL scalars (s1, s2, s3) that returns the energy per reference volume
            [J/m^3]; arguments that follow are parameters. It must be symmetric in the singular
            values. With two, (s1, s2), it serves 2x2 and 3x2 gradients, and the in-plane block of a
            plane body. Constants and Functions of the mesh may also stand in its text.
        improper: Take all singular values >= 0, so that a reflection costs nothing: U in O(3).
        clamp: Where psi_hat is not smooth in F, as with s1 + s2 + s3, the tangent contains
            1/(s_i + s_j), unbounded as s_i + s_j -> 0. The denominator is kept above
            clamp * max(min(s1, 1), clamp).

    Raises:
        ValueError: psi_hat does not begin with the singular values, or clamp is not above 0.

    Source: document 000.
    """

    name: str
    stretches: int
    improper: bool
    clamp: float
    __name__: str
    __qualname__: str
    __signature__: inspect.Signature
    _psi_hat: Callable[..., Expr]
    _check: Callable[..., None] | None
    _functions: dict[tuple, StretchFunction]

    def __init__(
        self,
        psi_hat: Callable[..., Expr],
        improper: bool = False,
        clamp: float = 1e-6,
        check: Callable[..., None] | None = None,
    ) -> None:
        if not callable(psi_hat) or isinstance(psi_hat, ufl.core.expr.Expr):
            raise ValueError(
                "an energy in singular values is a function of them, as lambda s1, s2, s3: "
                f"mu * ((s1 - 1)**2 + ...), got {type(psi_hat).__name__}."
            )
        if not (isinstance(clamp, Real) and 0 < clamp < 1):
            raise ValueError(f"clamp must be between 0 and 1, got {clamp}.")
        given = inspect.signature(psi_hat)
        names = list(given.parameters)
        self.name = getattr(psi_hat, "__name__", "psi_hat").replace("<lambda>", "psi_hat")
        n = next((n for n in (3, 2) if tuple(names[:n]) == STRETCHES[:n]), 0)
        if not n and len(names) in (2, 3):
            n = len(names)
        if not n:
            raise ValueError(
                f"{self.name} must take the singular values first, as (s1, s2, s3, mu, lmbda) or "
                f"(s1, s2, mu, lmbda), got ({', '.join(names)})."
            )
        self.stretches, self.improper, self.clamp = n, improper, float(clamp)
        self._psi_hat, self._check = psi_hat, check
        self._functions = {}
        kinds = {p.kind for p in given.parameters.values()}
        taken = [name for name in names[n:] if name in ("F", "project")]
        if not kinds <= {inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY}:
            raise ValueError(f"{self.name} needs parameters with names, got {given}.")
        if taken:
            raise ValueError(f"a parameter of {self.name} may not be named {taken[0]}: rename it.")
        blank = inspect.Parameter.empty
        following = [p.replace(annotation=blank) for p in list(given.parameters.values())[n:]]
        argument = inspect.Parameter("F", inspect.Parameter.POSITIONAL_OR_KEYWORD)
        self.__signature__ = inspect.Signature([argument, *following])
        self.__doc__ = psi_hat.__doc__ or type(self).__doc__
        self.__name__ = self.__qualname__ = self.name

    def __repr__(self) -> str:
        return f"<energy {self.name}{self.__signature__}>"

    def __call__(self, F: Expr, *args: Any, **parameters: Any) -> Expr:
        """Energy density as a UFL scalar.

        Args:
            F: Deformation gradient: (3, 3), or (2, 2) for plane strain; (2, 2) or (3, 2) where
                psi_hat has two arguments.
            *args: Parameters of psi_hat, in order: numbers, Constants, Functions, expressions.
            **parameters: Parameters by name.

        Raises:
            ValueError: a shape or parameter that does not fit, or a psi_hat that is not symmetric.
        """
        X = self._operand(F)
        values = self._values(args, parameters)
        for key, value in values.items():
            for number in value if isinstance(value, list | tuple) else (value,):
                _check_scalar(number, key, self.name)
        if not ufl.domain.extract_domains(X):
            raise ValueError(
                f"{self.name} needs an F of a mesh, got one of numbers only: for those there is "
                f"{self.name}.evaluate."
            )
        domains = {ufl.domain.extract_unique_domain(X)}
        for value in _flattened(values):
            domains.update(() if isinstance(value, Real) else ufl.domain.extract_domains(value))
        if len(domains) > 1:
            raise ValueError(
                f"{self.name}'s parameters and F must be of one mesh, got {len(domains)}: make "
                "them with the body that the unknown was made with."
            )
        (domain,) = domains
        # As Constants, so that another value needs no other compilation.
        given = {
            key: _each(
                v, lambda x: fem.Constant(domain, np.float64(x)) if isinstance(x, Real) else x
            )
            for key, v in values.items()
        }
        function = StretchFunction(self._bound(given), self.stretches, self.name)
        return singular_value_function(X, function, self.improper, self.clamp)

    def evaluate(
        self, F: ArrayLike, *args: Any, project: bool = False, **parameters: Any
    ) -> tuple[Array, Array]:
        """Stress and tangent of arrays, by the kernels that a solve uses; local.

        Args:
            F: Deformation gradients, shape (n, 3, 3), or (n, 2, 2), (n, 3, 2) for two arguments.
            *args: Parameters of psi_hat, in order: numbers, or arrays of shape (n,); lists and
                tuples are parameters that are lists, as those of Ogden's energy.
            project: Make the tangents positive semi-definite.
            **parameters: Parameters by name.

        Returns:
            P = dpsi/dF [Pa], the shape of F, and dP/dF [Pa], shape (n, 3, 3, 3, 3).

        Raises:
            ValueError: another shape, or entries that are not finite.
        """
        P, A = self._evaluate(F, args, parameters, (1, 2), project)
        return P, A

    def energy(self, F: ArrayLike, *args: Any, **parameters: Any) -> Array:
        """Energy density of arrays, shape (n,): arguments as :meth:`evaluate`; local."""
        (W,) = self._evaluate(F, args, parameters, (0,), False)
        return W

    def mapped(
        self, transform: Callable[[Callable[..., Expr]], Callable[..., Expr]], name: str
    ) -> SingularValueEnergy:
        """The energy of transform(psi_hat), with the same parameters."""
        energy = copy.copy(self)
        psi_hat = self._psi_hat
        energy._functions = {}
        energy._psi_hat = lambda *s, **values: transform(lambda *q: psi_hat(*q, **values))(*s)
        energy.name = energy.__name__ = energy.__qualname__ = name
        return energy

    def _evaluate(
        self, F: ArrayLike, args: Any, parameters: Any, levels: tuple[int, ...], project: bool
    ) -> tuple[Array, ...]:
        values = self._values(args, parameters)
        array = numbers_of(F, "F", f"{self.name}.evaluate")
        shapes = [(3, 3)] if self.stretches == 3 else [(2, 2), (3, 2)]
        wanted = " or ".join(f"(n, {a}, {b})" for a, b in shapes)
        if array.ndim != 3 or array.shape[1:] not in shapes:
            raise ValueError(f"{self.name} needs F of shape {wanted}, got {array.shape}.")
        if not np.all(np.isfinite(array)):
            bad = int(np.argmin(np.isfinite(array).all(axis=(1, 2))))
            raise ValueError(f"{self.name} needs finite F, got {array[bad].tolist()} at {bad}.")
        function, stand_ins = self._numeric(values)
        known = dict(zip(stand_ins, _flattened(values), strict=True))
        columns = []
        for p in function.parameters:
            column = known.get(p)
            if p in known:
                column = numbers_of(column, "parameters", f"{self.name}.evaluate")
            column = np.array(_present_value(p, self.name)) if column is None else column
            if column.shape not in ((), (len(array),)):
                raise ValueError(
                    f"{self.name} needs parameters that are numbers or one per F, shape "
                    f"({len(array)},), got {column.shape}."
                )
            if not np.all(np.isfinite(column)):
                raise ValueError(f"{self.name} needs finite parameters, got {column}.")
            columns.append(np.broadcast_to(column, len(array)))
        rows, cols = array.shape[1:]
        kind = Kind(function, (rows, cols), False, self.improper, self.clamp)
        X = np.column_stack([array.reshape(len(array), rows * cols), *columns])
        return evaluate(kind, X, levels, project)

    def _numeric(self, values: dict[str, Any]) -> tuple[StretchFunction, list[Expr]]:
        """psi_hat with stand-ins for its parameters, so that numbers need no compilation.

        Its text is read at each call, as what stands in it may have changed; what has been derived
        from a text is kept.
        """
        stand_ins: list[Expr] = []

        def following(_: Any) -> Expr:
            stand_ins.append(stand_in(len(stand_ins)))
            return stand_ins[-1]

        bound = self._bound({k: _each(v, following) for k, v in values.items()})
        psi = text(bound, self.stretches, self.name)
        said = fingerprint(psi)
        function = self._functions.pop(said, None)
        if function is None:
            function = StretchFunction(lambda *_: psi, self.stretches, self.name)
        self._functions[said] = function  # the last one used comes last
        while len(self._functions) > TEXTS:
            del self._functions[next(iter(self._functions))]
        return function, stand_ins

    def _bound(self, values: dict[str, Any]) -> Callable[..., Expr]:
        return lambda *s: self._psi_hat(*s, **values)

    def _values(self, args: Any, parameters: Any) -> dict[str, Any]:
        """Parameters by name, defaults filled in, numbers checked."""
        try:
            bound = self.__signature__.bind(None, *args, **parameters)
        except TypeError as error:
            raise ValueError(f"{self.name}{self.__signature__}: {error}.") from None
        bound.apply_defaults()
        values = {key: value for key, value in bound.arguments.items() if key != "F"}
        for key, value in values.items():
            for number in value if isinstance(value, list | tuple) else (value,):
                if isinstance(number, Real) and not isfinite(number):
                    raise ValueError(f"{self.name} needs a finite {key}, got {value}.")
        if self._check is not None:
            self._check(self.name, **values)
        return values

    def _operand(self, F: Expr) -> Expr:
        if not isinstance(F, ufl.core.expr.Expr):
            raise ValueError(
                f"{self.name} needs a deformation gradient in UFL, got {type(F).__name__}; for "
                f"arrays there is {self.name}.evaluate."
            )
        if self.stretches == 3 and F.ufl_shape == (2, 2):
            return ufl.as_matrix([[F[0, 0], F[0, 1], 0], [F[1, 0], F[1, 1], 0], [0, 0, 1]])
        if self.stretches == 2 and F.ufl_shape == (3, 3) and is_plane(F):
            return ufl.as_matrix([[F[0, 0], F[0, 1]], [F[1, 0], F[1, 1]]])
        shapes = [(3, 3), (2, 2)] if self.stretches == 3 else [(2, 2), (3, 2)]
        if F.ufl_shape not in shapes:
            raise ValueError(
                f"{self.name} of {self.stretches} singular values needs an F of shape "
                f"{' or '.join(map(str, shapes))}, got {F.ufl_shape}: pass "
                "forms.deformation_gradient(u)."
            )
        return F


def _each(value: Any, make: Callable[[Any], Any]) -> Any:
    return [make(v) for v in value] if isinstance(value, list | tuple) else make(value)


def _check_scalar(value: Any, key: str, name: str) -> None:
    """Refuse what is neither a number nor a UFL scalar."""
    shape = getattr(value, "ufl_shape", None)
    if not isinstance(value, Real) and shape != ():
        raise ValueError(
            f"{name} needs {key} as a number or a UFL scalar, got {type(value).__name__}"
            + (f" of shape {shape}." if shape else ".")
        )


def _flattened(values: dict[str, Any]) -> list[Any]:
    parts = ((v if isinstance(v, list | tuple) else [v]) for v in values.values())
    return [x for part in parts for x in part]


def _present_value(parameter: Expr, name: str) -> float:
    """Present value of a Constant, or of an entry of one, that stands in the text of psi_hat."""
    entry: tuple[int, ...] = ()
    if isinstance(parameter, ufl.classes.Indexed):
        parameter, index = parameter.ufl_operands
        entry = tuple(int(i) for i in index)
    if not isinstance(parameter, fem.Constant):
        raise ValueError(
            f"{name} contains {parameter}, which has no value outside a mesh: make it a parameter "
            "of psi_hat and pass numbers."
        )
    return float(np.asarray(parameter.value)[entry])
