# SPDX-License-Identifier: MIT
"""Ogden's and Mooney-Rivlin's energies fitted to Treloar's measurements of 1944 on rubber.

Uniaxial tension, equibiaxial tension and pure shear of one rubber, fitted together: each way counts
by its squared errors over its squared stresses. The stresses are those of the package's energies at
F = diag(l1, l2, l3), l1 l2 l3 = 1, with the pressure that frees the third face of stress.
"""

from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from matplotlib.figure import Figure
from scipy.optimize import least_squares

from variform import forms, meshes

DATA = Path(__file__).resolve().parent / "data"
GAUSS_NEWTON = 20
MODES = {
    "uniaxial": lambda k: (k, k**-0.5, k**-0.5),
    "equibiaxial": lambda k: (k, k, k**-2),
    "pure_shear": lambda k: (k, 1 + 0 * k, 1 / k),
}
# Ogden 1972, with 1 kg/cm^2 = 0.0980665 MPa.
PUBLISHED = (0.0980665 * np.array([6.3, 0.012, -0.1]), np.array([1.3, 5.0, -2.0]))


def measured(mode, source="ovgu"):
    """Stretches and nominal stresses [MPa] of one way of loading, as digitized by one source."""
    lines = (DATA / f"treloar_{mode}_{source}.csv").read_text().splitlines()
    rows = [line for line in lines if not line.startswith("#")]
    names = rows[0].split(",")
    columns = [names.index("stretch"), names.index("nominal_stress_MPa")]
    table = np.array([[float(row.split(",")[c]) for c in columns] for row in rows[1:]])
    return table[table[:, 0] > 1].T


class Response:
    """Nominal stress of an incompressible energy at given principal stretches.

    Args:
        energy: Function (F, parameters) that returns psi, without a volume term.
        parameters: How many parameters it has.
        stretches: Principal stretches, shape (3, n); the third face is free.
    """

    def __init__(self, energy, parameters, stretches):
        body = meshes.block(MPI.COMM_SELF, (1.0, 1.0), n=(stretches.shape[1], 1))
        cells = body.mesh.topology.index_map(2).size_local
        states = fem.Function(fem.functionspace(body.mesh, ("DG", 0, (3,))))
        # As many cells as states at least: those that are left over repeat the last state.
        self._cells = np.arange(stretches.shape[1])
        padded = stretches[:, np.minimum(np.arange(cells), stretches.shape[1] - 1)]
        states.x.array[:] = padded.T.ravel()
        F = ufl.variable(ufl.diag(states))
        self._parameters = [fem.Constant(body.mesh, 1.0) for _ in range(parameters)]
        P = forms.stress.first_piola(energy(F, self._parameters), F)
        nominal = P[0, 0] - P[2, 2] * states[2] / states[0]
        self._values = fem.Function(forms.fields.discontinuous(body.mesh, 0))
        self._evaluation = forms.fields.Evaluation(nominal, self._values)

    def __call__(self, parameters):
        """Nominal stress of each state, shape (n,)."""
        for constant, value in zip(self._parameters, parameters, strict=True):
            constant.value = value
        self._evaluation.update()
        return self._values.x.array[self._cells].copy()


def ogden(F, c):
    """Three terms: mu1, mu2, mu3, alpha1, alpha2, alpha3."""
    return forms.energies.ogden(F, c[:3], c[3:])


def mooney_rivlin(F, c):
    """Constants c10, c01."""
    return forms.energies.mooney_rivlin(F, *c)


ENERGIES = {
    "Ogden": (ogden, np.concatenate(PUBLISHED)),
    "Mooney-Rivlin": (mooney_rivlin, np.array([0.2, 0.01])),
}


def points():
    """Principal stretches (3, n), nominal stresses (n) and the rows of each way of loading."""
    stretches, stresses, rows, count = [], [], {}, 0
    for mode, principal in MODES.items():
        k, stress = measured(mode)
        stretches.append(np.array(principal(k)))
        stresses.append(stress)
        rows[mode] = slice(count, count + len(k))
        count += len(k)
    return np.concatenate(stretches, axis=1), np.concatenate(stresses), rows


def residuals(found, stresses, rows):
    """Root of the squared errors over that of the squared stresses, of each way of loading."""
    return {
        mode: float(np.linalg.norm(found[r] - stresses[r]) / np.linalg.norm(stresses[r]))
        for mode, r in rows.items()
    }


def fit(name):
    """Parameters of an energy fitted to all three ways, and the residuals of each."""
    energy, start = ENERGIES[name]
    stretches, stresses, rows = points()
    response = Response(energy, len(start), stretches)
    weight = np.empty_like(stresses)
    for r in rows.values():
        weight[r] = 1 / np.linalg.norm(stresses[r])

    def errors(c):
        return weight * (response(c * start) - stresses)

    def slopes(c):
        """Derivatives of the errors by differences of fourth order: the fit is ill-conditioned."""
        columns = []
        for step in 1e-4 * np.eye(len(c)):
            one, two = (errors(c + n * step) - errors(c - n * step) for n in (1, 2))
            columns.append((8 * one - two) / 12e-4)
        return np.stack(columns, axis=1)

    c = least_squares(errors, np.ones(len(start)), slopes, x_scale="jac", max_nfev=1000).x
    # It stops where the squares no longer fall, half the digits before the parameters stand still.
    for _ in range(GAUSS_NEWTON):
        c = c - np.linalg.lstsq(slopes(c), errors(c), rcond=None)[0]
    return c * start, residuals(response(c * start), stresses, rows)


def spread(mode):
    """Median distance of the other digitizations from the one fitted, over the stress."""
    k, stress = measured(mode)
    far = []
    for file in sorted(DATA.glob(f"treloar_{mode}_*.csv")):
        source = file.stem.rpartition("_")[2]
        if source != "ovgu":
            others = measured(mode, source)
            inside = (others[0] >= k[0]) & (others[0] <= k[-1])
            at = np.interp(others[0][inside], k, stress)
            far.append(np.abs(others[1][inside] / at - 1))
    return float(np.median(np.concatenate(far)))


def run(folder, comm=MPI.COMM_WORLD):
    """Residuals of both fits, of Ogden's own parameters, the spread of the data, and the chart."""
    numbers, fitted = {}, {}
    stretches, stresses, rows = points()
    own = Response(ogden, 6, stretches)(np.concatenate(PUBLISHED))
    for mode, value in residuals(own, stresses, rows).items():
        numbers[f"Ogden 1972, {mode}"] = value
    for name in ENERGIES:
        fitted[name], found = fit(name)
        numbers |= {f"{name}, {mode}": value for mode, value in found.items()}
    numbers |= {f"spread, {mode}": spread(mode) for mode in MODES}
    if comm.rank == 0:
        _draw(folder / "treloar.png", fitted)
    return {key.replace("_", " "): value for key, value in numbers.items()}


def _draw(file, fitted):
    figure = Figure((12, 4), 150, layout="constrained")
    for axes, (mode, principal) in zip(figure.subplots(1, 3), MODES.items(), strict=True):
        k, stress = measured(mode)
        axes.plot(k, stress, "ko", ms=4, label="Treloar 1944")
        fine = np.linspace(1.0001, k[-1], 200)
        for name, style in zip(ENERGIES, ("C0-", "C1--"), strict=True):
            energy, start = ENERGIES[name]
            response = Response(energy, len(start), np.array(principal(fine)))
            axes.plot(fine, response(fitted[name]), style, label=f"{name}, fitted")
        axes.set(title=mode.replace("_", " "), xlabel="stretch [-]", ylim=(0, None))
    figure.axes[0].set_ylabel("nominal stress [MPa]")
    figure.axes[0].legend()
    figure.savefig(file)
