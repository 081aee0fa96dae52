# SPDX-License-Identifier: MIT
"""Problems 2 and 3 of the cardiac benchmark, Land et al., Proc. R. Soc. A 471 (2015) 20150641.

A left ventricle, the truncated ellipsoid of ``meshes.ellipsoid`` (mm, kPa), is held at its base and
blown up. In problem 3 its fibers pull as well, and it twists. The number is where the apex goes.

Each is solved as a solid, and as a body of revolution, which both problems are: their meridian
section with far smaller cells, and yet so small that each rank solves it by itself. That of problem
3 turns about its axis, which ``forms.axisymmetric`` does not; its F and its Newton method are
written out below.
"""

from mpi4py import MPI
from petsc4py import PETSc

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem

from variform import forms, meshes

APEX = {"endo": -17.0, "epi": -20.0}
SECTIONS = {2: (4, 40), 3: (8, 80)}  # cells across the wall and along it
TIGHT = {"rtol": 1e-13, "ctol": 1e-11}


def passive(problem, F, fiber):
    """Guccione's muscle with the constants of problem 2 or 3, of the isochoric part of F."""
    C, bf, bt, bfs = {2: (10.0, 1.0, 1.0, 1.0), 3: (2.0, 8.0, 2.0, 4.0)}[problem]
    return forms.energies.guccione(forms.kinematics.isochoric(F), C, bf, bt, bfs, fiber)


def solid(problem, h=4.0, at_apex=None, comm=MPI.COMM_WORLD):
    """Path to the full load of the ventricle in space, cubic displacements; and F.

    The rim of the endocardium is held, so that the pressure has a potential and the tangent is
    symmetric. Both loads, and then equilibrium once more as exactly as rounding lets it.
    """
    body = meshes.ellipsoid(comm, h, order=2, apex=at_apex)
    t = forms.load_factor(body)
    w = forms.displacement_pressure(body, degree=3)
    u, p = ufl.split(w)
    F = forms.deformation_gradient(u)
    fiber = meshes.ellipsoid_fiber_field(body)
    psi = passive(problem, F, fiber)
    if problem == 3:
        psi += forms.energies.active_tension(F, 60 * t, fiber)
    psi = forms.energies.with_pressure(psi, F, p)
    inside = {2: 10 * t, 3: 15 * t}[problem]
    potential = psi * ufl.dx + forms.pressure_potential(u, inside, body.ds("endo"))
    held = [forms.clamp(w, body.facets("base"))]
    first = {2: 0.05, 3: 0.1}[problem]
    forms.follow(potential, w, held, t, step=first, max_step=0.25, progress=False)
    path = forms.solve(potential, w, held, record={"apex": apex}, **TIGHT)
    return path, F, fiber


def apex(system):
    """Heights of the apex inside and outside [mm]."""
    u = forms.displacement_of(system.u)
    # The apex need not be a node, and quadratic sides pass it by some 1e-6 of its height.
    return [z + float(forms.at(u, (0, 0, z), 1e-6)[2]) for z in APEX.values()]


def section(across, along):
    """Meridian section (r, z) of the ventricle: across x along quadratic quadrilaterals.

    Boundaries: left (endocardium), right, bottom (axis) and top (base).
    """
    body = meshes.block(
        MPI.COMM_SELF, (1.0, 1.0), n=(across, along), cells="quadrilateral", order=2
    )
    x = body.mesh.geometry.x
    short, long = 7 + 3 * x[:, 0], 17 + 3 * x[:, 0]
    angle = x[:, 1] * (np.pi - np.arccos(5 / long))  # from the apex to the base
    x[:, 0], x[:, 1] = short * np.sin(angle), -long * np.cos(angle)
    return body


def revolved(problem, across, along):
    """Displacement (r, z) of the section, and a stretch to color it by. Local."""
    body = section(across, along)
    w, stretch = (_straight if problem == 2 else _turning)(body)
    return w.sub(0).collapse(), stretch


def _straight(body):
    """Problem 2 by ``forms.axisymmetric``."""
    t, w = forms.load_factor(body), forms.displacement_pressure(body)
    u, p = ufl.split(w)
    F, ring = forms.axisymmetric(u), forms.circumference(u)
    psi = forms.energies.with_pressure(passive(2, F, (1.0, 0.0, 0.0)), F, p)
    v, _ = ufl.split(ufl.TestFunction(w.function_space))
    work = forms.follower_pressure(u, 10 * t * ring, v, body.ds("left"), F)
    held = [forms.clamp(w, body.facets("top")), forms.roller(w, body.facets("bottom"), 0)]
    energy = psi * ring * ufl.dx(degree=6)
    forms.follow(energy, w, held, t, step=0.05, max_step=0.2, virtual_work=work, progress=False)
    forms.solve(energy, w, held, virtual_work=work, **TIGHT)
    return w, F[2, 2]


def _turning(body):
    """Problem 3: (R, Theta, Z) goes to (R + u_r, Theta + turn, Z + u_z), functions of R and Z."""
    mesh = body.mesh
    quadratic, cell = basix.ufl.element("Lagrange", mesh.basix_cell(), 2), mesh.basix_cell()
    parts = [basix.ufl.blocked_element(quadratic, (2,)), quadratic]
    parts.append(basix.ufl.element("Lagrange", cell, 1))
    W = fem.functionspace(mesh, basix.ufl.mixed_element(parts))
    w, t = fem.Function(W), fem.Constant(mesh, 0.0)
    u, turn, p = ufl.split(w)
    v, v_turn, _ = ufl.split(ufl.TestFunction(W))
    R, Z = ufl.SpatialCoordinate(mesh)
    r, z = R + u[0], Z + u[1]
    around = ufl.conditional(ufl.gt(R, 0.0), r / R, r.dx(0))  # on the axis, which pictures reach
    F = ufl.as_matrix(
        [
            [r.dx(0), 0, r.dx(1)],
            [r * turn.dx(0), around, r * turn.dx(1)],
            [z.dx(0), 0, z.dx(1)],
        ]
    )
    fiber = meshes.ellipsoid_fiber_field(body)
    psi = passive(3, F, fiber) + forms.energies.active_tension(F, 60 * t, fiber)
    psi = forms.energies.with_pressure(psi, F, p)
    N = ufl.FacetNormal(mesh)
    n = ufl.cofac(F) * ufl.as_vector([N[0], 0, N[1]])
    work = 15 * t * R * (n[0] * v[0] + n[1] * r * v_turn + n[2] * v[1])
    residual = ufl.derivative(psi * R * ufl.dx(degree=6), w) + work * body.ds("left", degree=6)
    spaces = (W.sub(0).sub(0), "top"), (W.sub(0).sub(1), "top"), (W.sub(1), "top")
    held = [
        fem.locate_dofs_topological(V, 1, body.facets(name))
        for V, name in (*spaces, (W.sub(0).sub(0), "bottom"))
    ]
    free = np.setdiff1d(np.arange(len(w.x.array)), np.concatenate(held))
    compiled = [forms.compiled(form) for form in (residual, ufl.derivative(residual, w))]
    for load in np.linspace(0, 1, 21)[1:]:
        t.value = load
        _newton(w, *compiled, free)
    return w, ufl.sqrt(forms.kinematics.fiber_invariants(F, fiber)[0])


def _newton(w, residual, tangent, free):
    """Full steps until what is out of balance is 1e-11 of the reactions."""
    for _ in range(30):
        force = fem.assemble_vector(residual).array
        if np.linalg.norm(force[free]) <= 1e-11 * np.linalg.norm(force):
            return
        K = fem.assemble_matrix(tangent).to_scipy().tocsr()[free][:, free]
        A = PETSc.Mat().createAIJ(K.shape, csr=(K.indptr, K.indices, K.data), comm=MPI.COMM_SELF)
        lu = PETSc.KSP().create(MPI.COMM_SELF)
        lu.setOperators(A)
        lu.setType("preonly")
        lu.getPC().setType("lu")
        lu.getPC().setFactorSolverType("mumps")
        b, x = A.createVecs()
        b.array[:] = force[free]
        lu.solve(b, x)
        w.x.array[free] -= x.array
        for item in (lu, A, b, x):
            item.destroy()
    raise RuntimeError("Newton's method on the section did not converge in 30 iterations.")


def run(problem, folder, comm=MPI.COMM_WORLD):
    """Numbers of problem 2 or 3, and the pictures of the solid and of its section."""
    path, F, fiber = solid(problem, at_apex={2: None, 3: 0.35}[problem], comm=comm)
    numbers = dict(zip(APEX, path.record("apex")[-1], strict=True))
    rest = forms.integral(fem.Constant(path.u.function_space.mesh, 1.0) * ufl.dx)
    numbers["volume over that at rest"] = forms.volume(F, ufl.dx(degree=6)) / rest
    stretch = ufl.sqrt(forms.kinematics.fiber_invariants(F, fiber)[0])
    label = "stretch along\nthe fibers [-]"
    forms.picture(path, folder / f"land{problem}_solid.png", stretch, label, view=(0.5, -1, 0.25))
    u, stretch = revolved(problem, *SECTIONS[problem])
    label = "stretch around\nthe axis [-]" if problem == 2 else label
    # Where fibers meet at the apex their stretch leaves the range of the rest.
    limits = {2: None, 3: (0.75, 1.1)}[problem]
    if comm.rank == 0:
        forms.picture(u, folder / f"land{problem}.png", stretch, label, limits=limits)
    for name, z in APEX.items():
        numbers[f"{name} of the section"] = z + float(forms.at(u, (0, z))[1])
    return numbers
