# SPDX-License-Identifier: MIT
"""Wrong arguments of a solve or a path are refused in one sentence, before anything is solved."""

import math
import re

import numpy as np
import pytest
import ufl
from cases import at_plane, unit_mesh

from variform import forms


def test_no_way_to_go_is_refused():
    mesh = unit_mesh(2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh, 1.0)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    with pytest.raises(ValueError, match=r"the load factor is at 1.0 already: use solve"):
        forms.follow(psi, u, [], t, to=1.0, progress=False)


@pytest.mark.parametrize(("name", "value"), [("step", 0.0), ("min_step", -1.0), ("max_step", 0.0)])
def test_steps_that_are_not_positive_are_refused(name, value):
    mesh = unit_mesh(2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    with pytest.raises(ValueError, match=f"{name} = {value}"):
        forms.follow(psi, u, [], t, **{name: value}, progress=False)


def test_a_load_factor_that_nothing_depends_on_is_refused():
    mesh = unit_mesh(2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    fixed = forms.clamp(u, at_plane(mesh, 0, 0.0))
    with pytest.raises(ValueError, match="nothing depends on the load factor t"):
        forms.follow(psi, u, [fixed], t, progress=False)
    with pytest.raises(ValueError, match=r"load factor of forms.load_factor, got float"):
        forms.follow(psi, u, [fixed], 0.0, progress=False)


def test_supports_of_another_unknown_are_refused():
    """They would be ignored, or read beyond the unknown's end."""
    mesh = unit_mesh(2)
    u, other = forms.displacement(mesh), forms.displacement(mesh, 2)
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    left = at_plane(mesh, 0, 0.0)
    for wrong in (forms.clamp(other, left), forms.clamp(forms.displacement(mesh), left)):
        with pytest.raises(ValueError, match="made for another unknown than displacement"):
            forms.solve(psi, u, [wrong])
    with pytest.raises(ValueError, match="what forms.clamp, .* got DirichletBC"):
        forms.solve(psi, u, forms.clamp(u, left).conditions)
    assert forms.solve(psi, u, forms.clamp(u, left)).completed  # one alone needs no list


def test_parts_of_a_mixed_unknown_are_refused():
    """w.split() gives functions that nothing is differentiated by."""
    mesh = unit_mesh(2)
    w = forms.displacement_pressure(mesh)
    F, (_, p) = forms.deformation_gradient(w.split()[0]), ufl.split(w)
    psi = forms.energies.with_pressure(forms.energies.isochoric_neo_hookean(F, 1.0), F, p, 1.0)
    with pytest.raises(ValueError, match="a part of w that is not differentiated"):
        forms.solve(psi * ufl.dx, w, [forms.clamp(w, at_plane(mesh, 0, 0.0))])
    with pytest.raises(ValueError, match="needs the unknown itself.* got Sum"):
        forms.solve(psi * ufl.dx, psi, [])


def test_a_virtual_work_in_a_potential_is_refused():
    """Also where a functional, a residual or a virtual work is wanted; a bilinear form as ever."""
    mesh = unit_mesh(2)
    u, t = forms.displacement(mesh), forms.load_factor(mesh)
    energy = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0) * ufl.dx
    work = forms.follower_pressure(u, t, ufl.TestFunction(u.function_space), ufl.ds)
    held = forms.clamp(u, at_plane(mesh, 0, 0.0))
    sentence = (
        "got a sum of forms with 0 and 1 arguments: a virtual work, as follower_pressure returns "
        "it, is passed as virtual_work=, and not added to a potential."
    )
    for need, call in (
        ("a potential must be a functional", lambda: forms.solve(energy + work, u, held)),
        ("a potential must be a functional", lambda: forms.follow(energy + work, u, held, t)),
        ("integral needs a functional", lambda: forms.integral(energy + work)),
        ("residual needs a potential", lambda: forms.residual(energy + work, u)),
        ("virtual_work must be", lambda: forms.solve(energy, u, held, virtual_work=energy + work)),
    ):
        with pytest.raises(ValueError, match=f"{need}.*{re.escape(sentence)}"):
            call()
    density = ufl.inner(u, u) + ufl.inner(u, ufl.TestFunction(u.function_space))  # in one integral
    with pytest.raises(ValueError, match=re.escape(sentence)):
        forms.solve(density * ufl.dx, u, held)
    with pytest.raises(ValueError, match="integral needs a functional, got a form with 1 arg"):
        forms.integral(work)


@pytest.mark.parametrize("shape", [(5, 3), (3, 1)])
def test_an_array_of_vectors_is_no_vector(shape):
    """A fiber of each cell as NumPy has them; the way to give them is said."""
    u = forms.displacement(unit_mesh(3))
    F, fibers = forms.deformation_gradient(u), np.ones(shape)
    for what, call in (
        ("a fiber", lambda: forms.energies.guccione(F, 1.0, 1.0, 1.0, 1.0, fibers)),
        ("a fiber", lambda: forms.kinematics.fiber_invariants(F, fibers)),
        ("a body force", lambda: forms.body_force(u, fibers)),
    ):
        sentence = f"{what} needs the shape (3,), got an array of shape {shape}: for a vector in"
        with pytest.raises(ValueError, match=re.escape(sentence)):
            call()


@pytest.mark.parametrize(
    "function",
    [
        lambda x: max(x, 1.0),
        lambda x: x if x > 1 else 1.0,
        lambda x: np.maximum(x, 1.0),
        lambda x: np.log(x),
        lambda x: math.log(x),
    ],
    ids=["max", "if", "maximum", "log", "math"],
)
def test_an_energy_of_python_s_or_numpy_s_functions_is_refused(function):
    """Wherever the package calls it; other errors of it are left as they are."""
    mesh = unit_mesh(2)
    u = forms.displacement(mesh)
    F, energies = forms.deformation_gradient(u), forms.energies

    def mine(a, b, c):
        return function(a) + function(b) + function(c)

    for name, call in (
        ("mine", lambda: energies.principal(mine)(F)),
        ("isotropic's psi", lambda: energies.isotropic(F, mine)),
        ("the energy", lambda: forms.evaluate(lambda F: function(ufl.det(F)), np.eye(3))),
        ("plane_stress's psi", lambda: forms.plane_stress(u, lambda F: function(ufl.det(F)))),
    ):
        with pytest.raises(
            ValueError, match=rf"{name} failed on UFL scalars \(.*\): write it with"
        ):
            call()

    def wrong(*_):
        raise ValueError("mu is negative")

    with pytest.raises(ValueError, match="^mu is negative$"):
        energies.isotropic(F, wrong)
    with pytest.raises(ValueError, match=r"isotropic's psi cannot be called so: .*takes 1 posit"):
        energies.isotropic(F, lambda x: x)


def test_a_load_factor_of_another_mesh_is_named():
    """Of a plane one in a solid's support or potential: FFCx has no sentence for it."""
    plane, mesh = unit_mesh(2), unit_mesh(3)
    u, t = forms.displacement(mesh), forms.load_factor(plane)
    left = at_plane(mesh, 0, 0.0)
    sentence = (
        "{} on a mesh in 3 dimensions contains a Constant of a mesh in 2: make the load factor "
        "with this body, forms.load_factor(body)."
    )
    for call in (
        lambda: forms.translate(u, left, (t, 0.0, 0.0)),
        lambda: forms.rotate(u, left, t),
        lambda: forms.rotate(u, left, 0.1, shift=(t, 0.0, 0.0)),
    ):
        with pytest.raises(ValueError, match=re.escape(sentence.format("a support"))):
            call()
    psi = forms.energies.neo_hookean(forms.deformation_gradient(u), 1.0, 2.0)
    held = forms.clamp(u, left)
    for load in (lambda: forms.body_force(u, (t, 0.0, 0.0)), lambda: forms.gravity(u, t)):
        with pytest.raises(ValueError, match=re.escape(sentence.format("a body force"))):
            load()
    dx = ufl.dx(domain=mesh)
    with pytest.raises(ValueError, match=re.escape(sentence.format("a potential"))):
        forms.solve(psi * dx + forms.spring(u, t, dx), u, held)
    work = t * ufl.TestFunction(u.function_space)[0] * dx
    with pytest.raises(ValueError, match=re.escape(sentence.format("a virtual work"))):
        forms.solve(psi * dx, u, held, virtual_work=work)
    own = forms.load_factor(mesh)
    pull = u[0] * ufl.ds(domain=mesh)
    with pytest.raises(ValueError, match=re.escape(sentence.format("a functional"))):
        forms.control(psi * dx - own * pull, u, held, own, t * u[0] * dx, [0.1], progress=False)


def test_an_array_of_moduli_is_named():
    """NumPy multiplies UFL entry by entry: an array of energies, and no form."""
    mesh = unit_mesh(3)
    u = forms.displacement(mesh)
    F = forms.deformation_gradient(u)
    potential = forms.energies.neo_hookean(F, np.ones(4), 2.0) * ufl.dx(domain=mesh)
    with pytest.raises(ValueError, match=r"array of shape \(4,\).* fill the x.array of a Function"):
        forms.solve(potential, u, forms.clamp(u, at_plane(mesh, 0, 0.0)))
