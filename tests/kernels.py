# SPDX-License-Identifier: MIT
"""The compiled point kernels of an energy, as evaluators and forms call them."""

from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
import reference
import ufl

from variform.forms.native.library import library
from variform.forms.operators.evaluate import describe, evaluate
from variform.forms.operators.jets import Kind
from variform.forms.operators.stretches import NOWHERE, StretchFunction

CLAMP = 1e-6
UFL = SimpleNamespace(
    ln=ufl.ln, where=lambda x, y, below, above: ufl.conditional(ufl.lt(x, y), below, above)
)


class Kernels:
    """The package's kernels, as evaluators and forms call them."""

    def __init__(self):
        self.lib, self.ffi = library(MPI.COMM_SELF)
        self.functions = {}

    def function(self, psi_hat, n, parameters):
        key = psi_hat, n, parameters
        if key not in self.functions:
            numbers = [ufl.Constant(NOWHERE) for _ in range(parameters)]
            self.functions[key] = StretchFunction(
                lambda *s: psi_hat(s, UFL, *numbers), n, psi_hat.__name__
            )
        return self.functions[key]

    def evaluate(
        self, psi_hat, X, project=False, want="WPA", parameters=(), plane=False, improper=False
    ):
        """W, P, A at each operand of X, shape (..., rows, cols); None for what is not wanted."""
        X = np.asarray(X, float)
        rows, cols = X.shape[-2:]
        function = self.function(psi_hat, cols, len(parameters))
        kind = Kind(function, (rows, cols), plane, improper, CLAMP)
        n = X[..., 0, 0].size
        rest = np.tile(np.asarray(parameters, float), (n, 1))
        levels = tuple("WPA".index(name) for name in want)
        numbers = np.hstack([X.reshape(n, rows * cols), rest])
        out = dict(zip(want, evaluate(kind, numbers, levels, project), strict=True))
        lead = X.shape[:-2]
        return [out[a].reshape(lead + out[a].shape[1:]) if a in out else None for a in "WPA"]

    def calls(self, psi_hat, X):
        """How often the tangent at each operand of X evaluates psi_hat; the state itself is one."""
        function = self.function(psi_hat, X.shape[-1], 0)
        psi, _module = function.compiled(MPI.COMM_SELF)
        record = self.ffi.new("operator_t *")
        describe(self.ffi, record, Kind(function, X.shape[1:], False, False, CLAMP), psi)
        compiled, count = record.psi, 0

        def counted(*arguments):
            nonlocal count
            count += 1
            compiled(*arguments)

        record.psi = callback = self.ffi.callback("tabulate_t", counted)
        A, none, calls = np.empty(2 * X.shape[1:]), self.ffi.NULL, []
        for x in np.ascontiguousarray(X):
            count = 0
            self.lib.points(record, 1, self.pointer(x), 0, none, none, self.pointer(A))
            calls.append(count)
        del callback  # C held no reference to it
        return np.array(calls)

    def pointer(self, array):
        return self.ffi.cast("double *", array.ctypes.data)

    def svd(self, F, plane=False, improper=False):
        """U, s, V of each matrix of F, shape (n, rows, cols)."""
        F = np.ascontiguousarray(F, float)
        n, rows, cols = F.shape
        out = [np.zeros((n, rows, rows)), np.zeros((n, cols)), np.zeros((n, cols, cols))]
        pointers = [self.pointer(array) for array in (F, *out)]
        self.lib.singular_values(rows, cols, plane, improper, n, *pointers)
        return out


every_energy = pytest.mark.parametrize(
    "psi_hat", reference.ENERGIES, ids=lambda psi_hat: psi_hat.__name__
)
