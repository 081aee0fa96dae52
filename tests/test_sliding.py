# SPDX-License-Identifier: MIT
"""Coulomb friction of surfaces: a block on a meshed slope sticks, slides, and does work."""

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from quotients import rates

from variform import forms, meshes
from variform.forms import dissipation
from variform.forms.surface_friction import Sliding

pytest.importorskip("ipctk", reason="ipctk, an optional package, is not installed")

MU, G, RHO, GAP = 0.5, 9.81, 1000.0, 0.003
SLIDER = (0.4, 0.2, 0.2)
BED = (1.0, 0.1, 0.4)


def two_blocks(comm, dim=2):
    """A block above a bed of another mesh, a gap between them; "low" is the bed below."""
    points, cells, start = [], [], 0
    parts = ((BED, (13, 1, 3), (0, -BED[1], -0.1)), (SLIDER, (4, 2, 2), (0.1, GAP, 0.0)))
    for size, n, origin in parts:
        axes = [
            np.linspace(o, o + s, k + 1)
            for o, s, k in zip(origin[:dim], size[:dim], n[:dim], strict=True)
        ]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        number = np.arange(grid[..., 0].size).reshape(grid.shape[:-1])
        corners = np.ndindex((2,) * dim)
        i = [
            number[tuple(slice(a, a + k) for a, k in zip(c, n, strict=False))].ravel()
            for c in corners
        ]
        order = [0, 2, 3, 1] if dim == 2 else [0, 4, 6, 2, 1, 5, 7, 3]
        cells.append(np.stack([i[k] for k in order], axis=1) + start)
        points.append(grid.reshape(-1, dim))
        start += number.size
    x = np.concatenate(points)
    y, ids = x[:, 1], np.arange(len(x))
    names = {
        "bed": ids[np.isclose(y, -BED[1])],
        "upper": ids[np.isclose(y, GAP)],
        "lower": ids[np.isclose(y, 0.0)],
    }
    kind = {2: "quadrilateral", 3: "hexahedron"}[dim]
    return meshes.from_arrays(comm, x, np.concatenate(cells), cell=kind, boundaries=names)


def slide(ratio, to, ramp, scheme, speed, dim=2, comm=MPI.COMM_SELF, **options):
    """A block on a bed whose slope has tan(angle) = ratio mu; its pull grows over a time."""
    body = two_blocks(comm, dim)
    t, u = forms.load_factor(body), forms.displacement(body)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1e6, 2e6) * ufl.dx
    contact = forms.touching(u, body.ds("upper", "lower"), stiffness=2e5, dhat=0.005, parts=1)
    angle, bed = np.arctan(ratio * MU), forms.clamp(u, body.facets("bed"))
    pressed = psi + forms.gravity(u, RHO * np.cos(angle), G, direction=(0, -1, 0)[:dim])
    corner = forms.pin(u, (0.1, GAP, 0.0)[:dim], axes=[0] if dim == 2 else [0, 2])
    held = [bed, corner]
    if dim == 3:
        held.append(forms.pin(u, (0.1 + SLIDER[0], GAP, 0.0), axes=[2]))
    forms.solve([pressed, contact], u, held)
    along = RHO * np.sin(angle) * forms.table(t, [0, ramp], [0, 1])
    damped = [*forms.friction(contact, MU, speed), dissipation.kelvin_voigt(2e3)]
    pulled = pressed + forms.gravity(u, along, G, direction=(1, 0, 0)[:dim])
    path = forms.transient(
        [pulled, contact], u, bed, t, to=to, rho=RHO, scheme=scheme, dissipation=damped,
        progress=False, **options,
    )  # fmt: skip
    return angle, contact, path


def speeds(path, dim=2):
    """Times, and the block's speed along the bed, whose own momentum is nearly none."""
    area = np.prod(SLIDER[:dim])
    return (
        np.array([step.load for step in path.steps]),
        path.record("momentum")[:, 0] / (RHO * area),
    )


def test_derivatives_of_friction_have_their_rates():
    """E, R and K of D(b u + d) / b along a random direction: differences are of rate 2."""
    body = two_blocks(MPI.COMM_SELF)
    u = forms.displacement(body)
    contact = forms.touching(u, body.ds("upper", "lower"), stiffness=2.0, dhat=0.005)
    rate, inverse = (fem.Constant(body.mesh, value) for value in (10.0, 0.1))
    drift, lag = fem.Function(u.function_space), fem.Function(u.function_space)
    (friction,) = forms.friction(contact, MU, 1.0)
    term = Sliding(friction, rate, inverse, drift, lag)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1e-3, 1e-3) * ufl.dx
    problem = forms.Problem([psi, term], u)
    rng, size = np.random.default_rng(2), len(u.x.array)
    u.x.array[:] = 1e-3 * rng.standard_normal(size)
    drift.x.array[:] = rng.standard_normal(size)  # some stick, some slide
    problem.prepare()
    assert term.energy() > 0 and term.power() > 0
    first, second = rates(problem, rng.standard_normal(size), (8e-4, 4e-4, 2e-4))
    assert first == pytest.approx(2, abs=0.15) and second == pytest.approx(2, abs=0.3)


def test_a_block_sticks_to_a_meshed_slope():
    """At 0.99 of the angle of friction it creeps at 0.9 of the regularization's speed."""
    _, contact, path = slide(0.99, 1.0, 0.5, "bdf2", 1e-2)
    _, speed = speeds(path)
    assert speed.max() < 1e-2
    assert speed[-1] == pytest.approx(0.9e-2, rel=1e-2)  # 2 y - y^2 = 0.99 at y = 0.9
    assert contact.certified()


@pytest.mark.parametrize(
    ("scheme", "dim"),
    [
        ("bdf2", 2),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (("newmark", 2), ("bdf2", 3))),
    ],
)
def test_a_block_slides_on_a_meshed_slope(scheme, dim):
    """At 1.5 of it with g (sin - mu cos), 1 %; the work of friction is force times path, 1 %."""

    def expected(problem):
        """The force along, mu times that across, times the speed of sliding, from all points."""
        _, contact, _ = problem.terms
        contact.prepare()
        v = contact.surface.gathered(problem.motion.velocity.x.array)
        return -MU * np.sum(contact.forces()[:, 1] * v[:, 0])

    record = {"friction": lambda problem: problem.terms[-1].power(), "expected": expected}
    angle, contact, path = slide(1.5, 0.4, 1e-6, scheme, 1e-3, dim, record=record)
    times, speed = speeds(path, dim)
    later = times > 0.15
    rate = np.polyfit(times[later], speed[later], 1)[0]
    assert rate == pytest.approx(G * (np.sin(angle) - MU * np.cos(angle)), rel=1e-2)
    # At each time, as the block rocks a little where corners pass over nodes.
    work = np.trapezoid(np.r_[0, path.record("expected")], np.r_[0, times])
    found = np.trapezoid(np.r_[0, path.record("friction")], np.r_[0, times])
    assert found == pytest.approx(work, rel=1e-2)
    lost = sum(row.dissipated for row in path.ledger)  # viscosity's part is small
    assert lost == pytest.approx(work, rel=5e-2)
    assert path.ledger.missed < 1e-3 * path.ledger.exchanged and contact.certified()


def test_a_motion_with_friction_is_taken_up(tmp_path):
    """Broken off while it slides, it goes on as the uninterrupted one: bit by bit."""
    ends, runs = [], []
    for stop in (None, 40):
        for _ in range(1 if stop is None else 2):

            def breaks(path, stop=stop):
                if stop is not None and len(path.steps) == stop and path.resumed is None:
                    raise KeyboardInterrupt

            options = {"checkpoint": forms.Checkpoint(tmp_path / str(stop), every=1)}
            try:
                _, _, path = slide(1.5, 0.02, 1e-6, "bdf2", 1e-3, on_step=breaks, **options)
            except KeyboardInterrupt:
                continue
        ends.append(path.u.x.array.copy())
        runs.append([row.dissipated for row in path.ledger])
    assert path.resumed is not None and 0 < path.resumed < 0.02
    assert np.array_equal(ends[0], ends[1]) and runs[0] == runs[1] and runs[0][-1] > 0


def test_bad_input_of_friction_of_surfaces():
    """A mu in UFL, a tool, a contact that is not in the potential."""
    body = two_blocks(MPI.COMM_SELF)
    t, u = forms.load_factor(body), forms.displacement(body)
    contact = forms.touching(u, body.ds("upper", "lower"), stiffness=2e5, dhat=0.005)
    for arguments in ((t, 1e-3), (MU, 1e-3, (1.0, 0.0))):
        with pytest.raises(ValueError, match="friction of surfaces takes a number for mu and no"):
            forms.friction(contact, *arguments)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1e6, 2e6) * ufl.dx
    with pytest.raises(ValueError, match="friction acts in a contact of the potential, got one of"):
        forms.transient(psi, u, (), t, rho=RHO, dissipation=forms.friction(contact, MU, 1e-3))
