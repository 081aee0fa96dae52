# SPDX-License-Identifier: MIT
"""Operators of a tensor's singular values in UFL: an energy, its first and its second derivative.

An operator at an operand X is known by its jet (W, P, A) = (psi, dpsi/dX, d2psi/dXdX), three
coefficients whose values the compiled kernels compute point by point. A form that contains them is
differentiated by the chain rule: in direction d, W moves by P : X'[d] and P by A : X'[d].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import basix.ufl
import numpy as np
import ufl
from ufl.algorithms import expand_derivatives, extract_arguments, extract_coefficients
from ufl.algorithms.expand_indices import expand_indices

from .. import _dolfinx
from .._types import Expr
from ..differentiation import Pointwise, contains, rate, update_dependents
from ..native.canonical import without_variables
from .stretches import StretchFunction


@dataclass(frozen=True, eq=False)
class Kind:
    """What the compiled kernel has to know of an operator.

    Attributes:
        function: psi_hat of the singular values.
        shape: Shape of the operand, (3, 3), (2, 2) or (3, 2).
        plane: The operand is [[F2, 0], [0, f]]: the singular values are those of F2 and then f.
        improper: Singular values >= 0 and U in O(n), instead of rotations and a signed one.
        clamp: Floor of |s_i + s_j| for an energy that is not smooth there.
    """

    function: StretchFunction
    shape: tuple[int, int]
    plane: bool
    improper: bool
    clamp: float

    @property
    def smooth(self) -> bool:
        """Whether every quotient has a finite limit, so that nothing is clamped."""
        return self.function.even if self.shape == (3, 2) else self.function.smooth


class _Tag(ufl.Coefficient):
    """Marks the operator's kind inside a UFL expression, so that two operators are never equal."""

    def __init__(self, domain: Any, kind: Kind) -> None:
        super().__init__(ufl.FunctionSpace(domain, basix.ufl.element("DG", _cell(domain), 0)))
        self.kind = kind
        self.jets: dict[Expr, Jets] = {}

    def _ufl_signature_data_(self, renumbering: Any) -> Any:
        _refuse_compiling()


class SingularValueFunction(Pointwise):
    """psi_hat(singular values of X, parameters), a UFL scalar.

    Its one operand packs the entries of X, the parameters, and the tag that says which psi_hat.
    """

    @property
    def jets(self) -> Jets:
        """Coefficients that stand for the value and the derivatives at this operand."""
        (packed,) = self.ufl_operands
        tag = packed.ufl_operands[-1]
        if packed not in tag.jets:
            tag.jets[packed] = Jets(packed.ufl_operands[:-1], tag.kind)
        return tag.jets[packed]

    @property
    def value(self) -> Expr:
        """Coefficient of the value."""
        return self.jets[0]


def singular_value_function(
    X: Expr, function: StretchFunction, improper: bool = False, clamp: float = 1e-6
) -> Expr:
    """The UFL scalar psi_hat(s(X), p), to be used in any integrand.

    Args:
        X: Operand, shape (3, 3), (2, 2) or (3, 2).
        function: psi_hat; of 3 singular values for (3, 3), of 2 for the others.
        improper: Take all singular values >= 0.
        clamp: Floor of |s_i + s_j| where psi_hat is not smooth.
    """
    if any(contains(e, Pointwise) for e in (X, *function.parameters)):
        raise ValueError(
            f"the operand or a parameter of {function.name} contains an energy in singular values "
            "itself: only products and sums of them are possible."
        )
    if extract_arguments(ufl.as_vector([X[0, 0], *function.parameters])) or extract_arguments(X):
        raise ValueError(
            f"the operand and the parameters of {function.name} are coefficients: a test or trial "
            "function has no place in them."
        )
    domain = ufl.domain.extract_unique_domain(X)
    kind = Kind(function, X.ufl_shape, is_plane(X), improper, clamp)
    entries = [X[i, j] for i, j in np.ndindex(X.ufl_shape)]
    return SingularValueFunction(
        ufl.as_vector([*entries, *function.parameters, _Tag(domain, kind)])
    )


class Jets:
    """The coefficients (W, P, A) of one operator at one operand."""

    def __init__(self, packed: tuple[Expr, ...], kind: Kind) -> None:
        rows, cols = kind.shape
        self.kind = kind
        self.packed = ufl.as_vector(packed)
        entries = np.array(packed[: rows * cols], dtype=object).reshape(rows, cols)
        self.X = ufl.as_matrix(entries.tolist())
        self.parameters = packed[rows * cols :]
        self._packed = packed
        self._levels: dict[int, Jet] = {}
        self._by_parameter: dict[int, Jets] = {}

    def __getitem__(self, level: int) -> Jet:
        if level not in self._levels:
            self._levels[level] = Jet(self, level)
        return self._levels[level]

    def check_parameters(self, u: Any) -> None:
        """Refuse parameters that depend on the unknown.

        Each derivative by one is an operator of its own: two derivatives, by all components of all
        functions that are inside, would be more than an integral may have.
        """
        if self.parameters and u in extract_coefficients(ufl.as_vector(self.parameters)):
            raise ValueError(self.refusal)

    @property
    def refusal(self) -> str:
        """Sentence on a parameter that depends on the unknown."""
        return (
            f"a parameter of {self.kind.function.name} depends on the unknown: only its operand "
            "may; add such a term to the energy in plain UFL."
        )

    def by_parameter(self, k: int) -> Jets:
        """Those of d psi_hat / d p_k: singular values do not depend on parameters."""
        if k not in self._by_parameter:
            kind = replace(self.kind, function=self.kind.function.by_parameter(k))
            self._by_parameter[k] = Jets(self._packed, kind)
        return self._by_parameter[k]


class Jet(ufl.Coefficient):
    """One derivative of an operator, a :class:`~forms.differentiation.Dependent` coefficient."""

    def __init__(self, jets: Jets, level: int) -> None:
        domain = ufl.domain.extract_unique_domain(jets.packed)
        # The rule's points are put in when the form is compiled. Of degree 1, because UFL takes the
        # gradient of what has degree 0 for zero before anyone can object.
        element = basix.ufl.quadrature_element(
            _cell(domain), value_shape=level * jets.kind.shape, degree=1
        )
        super().__init__(ufl.FunctionSpace(domain, element))
        self.jets, self.level = jets, level

    def direction(self, unknown: Any, du: Expr) -> Expr:
        """Change when the unknown, or a parameter, moves by du.

        The next derivative contracted with X'[du], and the same derivative of d psi_hat / d p_k
        times p_k'[du].
        """
        found: Expr = ufl.classes.Zero(self.ufl_shape)
        dX = expand_derivatives(rate(self.jets.X, unknown, du))
        if not isinstance(dX, ufl.classes.Zero):
            found += _contract(self._following(), dX, self.level)
        for k, parameter in enumerate(self.jets.parameters):
            dp = expand_derivatives(rate(parameter, unknown, du))
            if not isinstance(dp, ufl.classes.Zero):
                found += dp * self.jets.by_parameter(k)[self.level]
        return found

    def slope(self, variable: Expr) -> Expr:
        """Derivative with respect to a ``ufl.variable`` of the operand."""
        dX = expand_derivatives(ufl.diff(self.jets.X, variable))
        i, j = ufl.indices(2)
        head, tail = ufl.indices(2 * self.level), ufl.indices(len(variable.ufl_shape))
        if self.jets.parameters:
            change = expand_derivatives(ufl.diff(ufl.as_vector(self.jets.parameters), variable))
            if not isinstance(change, ufl.classes.Zero):
                raise ValueError(self.jets.refusal)
        return ufl.as_tensor(self._following()[(*head, i, j)] * dX[(i, j, *tail)], head + tail)

    def _following(self) -> Jet:
        if self.level == 2:
            raise ValueError(
                "the third derivative of an energy in singular values is not available: a form "
                "that holds its tangent cannot be differentiated again."
            )
        return self.jets[self.level + 1]

    def update(self) -> None:
        """Bring what the operand depends on up to date; the kernels compute the values."""
        update_dependents(self.jets.packed)

    def _ufl_signature_data_(self, renumbering: Any) -> Any:
        _refuse_compiling()


def _contract(following: Expr, dX: Expr, level: int) -> Expr:
    if level == 0:
        return ufl.inner(following, dX)
    i, j, k, n = ufl.indices(4)
    return ufl.as_tensor(following[i, j, k, n] * dX[k, n], (i, j))


def _cell(domain: Any) -> str:
    return _dolfinx.cell_name(domain.ufl_cell())


def is_plane(X: Expr) -> bool:
    """Whether X is 3x3 and its entries 13, 23, 31, 32 vanish identically."""
    if X.ufl_shape != (3, 3):
        return False
    # An entry of a variable is never seen to vanish.
    plain = without_variables(expand_derivatives(X))
    outside = ((0, 2), (1, 2), (2, 0), (2, 1))
    return all(isinstance(expand_indices(plain[i, j]), ufl.classes.Zero) for i, j in outside)


def _refuse_compiling() -> None:
    raise ValueError(
        "a form with an energy in singular values is compiled by forms.compiled, not by "
        "dolfinx.fem.form, which knows nothing of its kernels."
    )
