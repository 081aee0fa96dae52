# SPDX-License-Identifier: MIT
"""Contact: a cylinder and a sphere on a plane against Hertz, two blocks pressed evenly."""

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from matplotlib.figure import Figure

from demos.benchmarks.hertz import known, parabola, width
from demos.benchmarks.stacks import stack
from variform import forms, meshes
from variform.forms import contact

# Cells in the half-width, and dhat over their size.
PER, REACH = 40, 0.1
EXACT = {"rtol": 1e-12, "ctol": 1e-10}
MU, LMBDA, BY = 1.0, 2.0, 0.1


def profile(kind, p, a, peak, body):
    """Root mean square of p - p_Hertz over that of p_Hertz, on the bottom. Collective."""
    r, ds = ufl.SpatialCoordinate(body.mesh)[0], body.ds("bottom", degree=8)
    weight = r if kind == "sphere" else 1.0
    exact = peak * ufl.sqrt(ufl.max_value(1 - (r / a) ** 2, 0))
    error = forms.integral((p - exact) ** 2 * weight * ds)
    return np.sqrt(error / forms.integral(exact**2 * weight * ds))


def at_nodes(p, body, comm):
    """Places along the bottom and values there, sorted; on rank 0."""
    V = p.function_space
    dofs = fem.locate_dofs_topological(V, 1, body.facets("bottom"))
    dofs = dofs[dofs < V.dofmap.index_map.size_local]
    found = comm.gather(np.c_[V.tabulate_dof_coordinates()[dofs, 0], p.x.array[dofs]])
    if comm.rank > 0:
        return None
    found = np.concatenate(found)
    return found[np.argsort(found[:, 0])].T


def hertz(folder, comm=MPI.COMM_WORLD):
    """Half-widths and largest pressures over Hertz's at the force found; the chart."""
    numbers, curves = {}, {}
    for kind in ("cylinder", "sphere"):
        path, body = parabola(kind, 1, PER, REACH, comm=comm, **EXACT)
        p = contact.pressure(path)
        a, peak = known(kind, -contact.force(path)[1])
        numbers[f"{kind}, half-width"] = width(kind, p, body) / a
        numbers[f"{kind}, peak"] = comm.allreduce(p.x.array.max(), MPI.MAX) / peak
        numbers[f"{kind}, profile"] = profile(kind, p, a, peak, body)
        curves[kind] = a, peak, at_nodes(p, body, comm)
    if comm.rank == 0:
        figure = Figure((8, 3.5), 150, layout="constrained")
        s = np.linspace(0, 1, 201)
        for axes, kind in zip(figure.subplots(1, 2), curves, strict=True):
            a, peak, (x, p) = curves[kind]
            axes.plot(s, np.sqrt(1 - s**2), "0.6", label="Hertz")
            axes.plot(x / a, p / peak, ".", color="C3", ms=4, label="computed")
            side = "x" if kind == "cylinder" else "r"
            axes.set(title=f"{kind} on a plane", xlabel=f"{side} / a", ylabel="pressure / p0")
            axes.set(xlim=(0, 1.3))
            axes.legend()
        figure.savefig(folder / "hertz.png")
    return numbers


def blocks(below, above, dhat, comm):
    """Two blocks between rollers, pressed together by BY of two heights: path, body, F, psi."""
    points, cells, names = stack(below, above, 0.5 * dhat)
    body = meshes.from_arrays(comm, points, cells, cell="quadrilateral", boundaries=names)
    u, t = forms.displacement(body), forms.load_factor(body)
    F = forms.deformation_gradient(u)
    psi = forms.energies.neo_hookean(F, MU, LMBDA)
    term = forms.touching(u, body.ds("low face", "up face"), stiffness=1.0, dhat=dhat)
    held = [forms.roller(u, body.facets("side 0"), 0), forms.roller(u, body.facets("low end"), 1)]
    held.append(forms.translate(u, body.facets("up end"), (None, -BY * t)))
    path = forms.follow([psi * ufl.dx, term], u, held, t, progress=False, **EXACT)
    return path, body, F, psi


def response(stretch):
    """Force that a block exerts on its supports at a stretch along it, none aside."""
    return -MU * (stretch - 1 / stretch) - LMBDA * np.log(stretch) / stretch


def press(folder, comm=MPI.COMM_WORLD):
    """Force over that of the two blocks in series, the evenness of the stress; the picture."""
    dhat, numbers = 1 / 1040, {}
    path, body, F, psi = blocks(8, 13, dhat, comm)
    g = contact.gap(path)
    gaps = [forms.integral(g * body.ds(f"{side} face")) for side in ("low", "up")]
    force = -forms.resultant(path, body.facets("up end"))[0][1]
    # Each block has half of what the gap leaves of the height.
    numbers["force"] = force / response((2 + 0.5 * dhat - BY - np.mean(gaps)) / 2)
    off = forms.stress.first_piola(psi, F)[1, 1] / -force - 1
    y = ufl.SpatialCoordinate(body.mesh)[1]
    for side, low, high in (("low", 1 - 1 / 8, 1), ("up", 1 + dhat / 2, 1 + 1 / 13 + dhat / 2)):
        beside = ufl.conditional(ufl.And(ufl.gt(y, low), ufl.lt(y, high)), off**2, 0.0)
        numbers[f"stress beside, {side}"] = np.sqrt(forms.integral(beside * ufl.dx) / (high - low))
    found = np.abs(forms.field(off, body.mesh, 0).x.array).max()
    numbers["stress, largest"] = comm.allreduce(found, MPI.MAX)
    forms.picture(path, folder / "press.png", 100 * off, "P22 off its mean [%]")
    return numbers
