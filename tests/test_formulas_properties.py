# SPDX-License-Identifier: MIT
"""Laws of documents 000, 001 and 002 for any state: isotropy, symmetry, scaling, 2D inside 3D."""

import itertools

import numpy as np
import pytest
import recorder
from cases import random_rotation
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from test_formulas_svd import ENERGIES, LOGARITHMIC, SMOOTH

from variform.forms.formulas import membrane_eigensystems as me
from variform.forms.formulas import membrane_invariants as mi
from variform.forms.formulas import polar as po
from variform.forms.formulas import quotients as qu
from variform.forms.formulas import svd_derivatives as sd

law = settings(max_examples=50, deadline=None, derandomize=True, database=None)
numbers = st.floats(-0.5, 0.5)
seeds = st.integers(0, 2**32 - 1)
names = st.sampled_from(list(ENERGIES))
GROUPS = st.sampled_from(["SO(3)", "O(3)"])


def shaped(rows, columns):
    return st.lists(numbers, min_size=rows * columns, max_size=rows * columns).map(
        lambda x: np.eye(rows, columns) + np.reshape(x, (rows, columns))
    )


def state(name, F):
    """A state in the domain of the energy, away from s_i + s_j = 0 where it has no tangent."""
    s = sd.signed_svd(F)[1]
    assume(s[-2] + s[-1] > 0.05)
    assume(name not in LOGARITHMIC or s[-1] > 0.05)
    return F


def tangent(name, F):
    U, s, V = sd.signed_svd(F)
    A, B = sd.tangent_blocks(ENERGIES[name], s, smooth=name in SMOOTH)
    return sd.tangent(U, V, A, B)


def close(found, wanted, tolerance=1e-11):
    """To a tolerance, relative to the largest entry but not to less than 1."""
    wanted = np.asarray(wanted)
    assert found.shape == wanted.shape
    error = np.abs(found - wanted).max() / max(1, np.abs(wanted).max())
    recorder.error(error)
    assert error < tolerance


# Document 000


@pytest.mark.capability(2)
@law
@given(names, shaped(3, 3), seeds)
def test_isotropy(name, F, seed):
    """psi, P and dP/dF turn with F: P(R F Q) = R P(F) Q for rotations."""
    rng = np.random.default_rng(seed)
    R, Q, energy = random_rotation(rng), random_rotation(rng), ENERGIES[name]
    turned = R @ state(name, F) @ Q
    close(energy.value(sd.signed_svd(turned)[1]), energy.value(sd.signed_svd(F)[1]), 1e-11)
    P = sd.first_piola(energy, F)
    close(sd.first_piola(energy, turned), R @ P @ Q)
    close(sd.turned_stress(lambda G: sd.first_piola(energy, G), F, R, Q), P)
    T = np.einsum("ia,jb,kc,ld,abcd->ijkl", R, Q.T, R, Q.T, tangent(name, F), optimize=True)
    close(tangent(name, turned), T, 1e-10)


@pytest.mark.capability(3)
@law
@given(names, shaped(3, 3), st.permutations(range(3)))
def test_permutation(name, F, order):
    """Exchanged stretches: the same energy, its derivatives exchanged."""
    s, energy = sd.signed_svd(state(name, F))[1], ENERGIES[name]
    close(energy.value(s[order]), energy.value(s), 1e-13)
    close(energy.gradient(s[order]), energy.gradient(s)[order], 1e-12)
    close(energy.hessian(s[order]), energy.hessian(s)[order][:, order], 1e-12)


@law
@given(names, shaped(3, 3))
def test_symmetries_of_the_tangent(name, F):
    """dP/dF is symmetric; its eigenvalues are those of A and the quotients of the pairs."""
    matrix = sd.to_matrix(tangent(name, state(name, F)))
    close(matrix, matrix.T, 1e-13)
    s, energy = sd.signed_svd(F)[1], ENERGIES[name]
    wanted = [np.linalg.eigvalsh(energy.hessian(s))]
    for i, j in qu.PAIRS[3]:
        wanted.append([qu.difference_quotient(energy, s, i, j)])
        wanted.append([qu.sum_quotient(energy, s, i, j, smooth=name in SMOOTH)])
    close(np.linalg.eigvalsh(matrix), np.sort(np.concatenate(wanted)), 1e-12)


@law
@given(names, shaped(3, 3), shaped(3, 3))
def test_spins_do_no_work(name, F, dF):
    """F P^T is symmetric, so P : W F = 0 for spins W, and dP = W P."""
    P = sd.first_piola(ENERGIES[name], state(name, F))
    close(F @ P.T, P @ F.T, 1e-12)
    spin = dF - dF.T
    turn = sd.tangent_action(tangent(name, F), spin @ F)
    close(turn, spin @ P, 1e-10)


@law
@given(shaped(3, 3), st.floats(0.2, 5))
def test_homogeneity(F, factor):
    """Sum s_i^4 is of degree 4: P of degree 3, dP/dF of degree 2, and dP/dF : F = 3 P."""
    quartic = qu.Energy(
        lambda s: np.sum(s**4, -1),
        lambda s: 4 * s**3,
        lambda s: 12 * s[..., :, None] ** 2 * np.eye(3),
    )
    tangents = []
    for G in (F, factor * F):
        U, s, V = sd.signed_svd(G)
        tangents.append(sd.tangent(U, V, *sd.tangent_blocks(quartic, s, smooth=True)))
    P = sd.first_piola(quartic, F)
    close(sd.first_piola(quartic, factor * F), factor**3 * P)
    close(tangents[1], factor**2 * tangents[0])
    close(sd.tangent_action(tangents[0], F), 3 * P)
    close(P, 4 * F @ F.T @ F)


@pytest.mark.capability(5)
@law
@given(names.filter(lambda name: name != "user"), shaped(2, 2), shaped(2, 2))
def test_plane_strain(name, F, dF):
    """2D is 3D with F_33 = 1: the same energy, stress and differential in the plane."""
    s = sd.signed_svd(F)[1]
    assume(abs(s[0] + s[1]) > 0.05 and abs(1 + s[1]) > 0.05)
    assume(name not in LOGARITHMIC or s[-1] > 0.05)
    solid, along = np.eye(3), np.zeros((3, 3))
    solid[:2, :2], along[:2, :2] = F, dF
    energy = ENERGIES[name]
    close(energy.value(s), energy.value(sd.signed_svd(solid)[1]), 1e-13)
    close(sd.first_piola(energy, F), sd.first_piola(energy, solid)[:2, :2], 1e-12)
    close(tangent(name, F), tangent(name, solid)[:2, :2, :2, :2], 1e-10)
    U, s, V = sd.signed_svd(F)
    blocks = sd.tangent_blocks(energy, s, smooth=name in SMOOTH)
    found = sd.differential(U, V, *blocks, dF)
    close(found, sd.tangent_action(tangent(name, solid), along)[:2, :2], 1e-10)


@pytest.mark.capability(9)
@law
@given(st.lists(st.floats(-4, 4), min_size=3, max_size=3), st.floats(-2, 2), st.floats(-2, 2))
def test_rotations_about_one_axis_add(r, a, b):
    """R(a r) R(b r) = R((a + b) r); R^T R = I; R r = r."""
    r = np.array(r)
    R = sd.rodrigues(a * r)
    close(R @ sd.rodrigues(b * r), sd.rodrigues((a + b) * r), 1e-13)
    close(R.T @ R, np.eye(3), 1e-14)
    close(R @ r, r, 1e-13)


# Document 001


def membrane(F):
    U, s, V = mi.svd(F)
    assume(s[1] > 0.2)
    return U, s, V


@pytest.mark.capability(25)
@law
@given(shaped(3, 2), seeds)
def test_membranes_do_not_feel_rotations(F, seed):
    """Invariants of R F Q are those of F, reflections too; the Hessian of the sheet turns."""
    rng = np.random.default_rng(seed)
    R, Q = -random_rotation(rng), np.linalg.qr(rng.normal(size=(2, 2)))[0]
    USV, turned = membrane(F), mi.svd(R @ F @ Q)
    close(mi.invariants_of_gradient(R @ F @ Q), mi.invariants(USV[1]), 1e-13)
    close(mi.gradients(*turned), R @ mi.gradients(*USV) @ Q, 1e-11)
    H = me.sheet_hessian(*USV, 1.3)
    wanted = np.einsum("ia,jb,kc,ld,abcd->ijkl", R, Q.T, R, Q.T, H, optimize=True)
    close(me.sheet_hessian(*turned, 1.3), wanted)


@pytest.mark.capability(39)
@law
@given(shaped(3, 2))
def test_eigensystem_of_the_sheet(F):
    """The eigenpairs sum up to the Hessian; its projection is that of eigh, minus the negative."""
    U, s, V = membrane(F)
    H = mi.to_matrix(me.sheet_hessian_short(U, s, V, 1.3))
    values, Q = me.eigensystem(U, s, V, 1.3)
    close(mi.to_matrix(mi.assemble(values, Q)), H)
    found, vectors = np.linalg.eigh(H)
    projected = mi.to_matrix(me.projected_hessian(U, s, V, 1.3))
    close(projected, vectors * np.maximum(found, 0) @ vectors.T)
    assert np.linalg.eigvalsh(projected).min() > -1e-11 * np.abs(H).max()


@law
@given(shaped(3, 2), st.floats(0.3, 3))
def test_homogeneity_of_the_invariants(F, factor):
    """I1 is of degree 1, I2 and I3 of degree 2; gradients and Hessians of one and two less."""
    U, s, V = membrane(F)
    degrees = np.array([1, 2, 2])
    scaled = mi.svd(factor * F)
    close(mi.invariants(scaled[1]), factor**degrees * mi.invariants(s))
    for k, degree in enumerate(degrees):
        g, H = mi.gradients(U, s, V)[k], mi.hessians(U, s, V)[k]
        close(mi.gradients(*scaled)[k], factor ** (degree - 1.0) * g)
        close(mi.hessians(*scaled)[k], factor ** (degree - 2.0) * H)
        close(np.sum(g * F), degree * mi.invariants(s)[k])
        close(np.einsum("ijkl,kl->ij", H, F), (degree - 1) * g)


@law
@given(shaped(3, 2), shaped(3, 2))
def test_membranes_embedded_in_3d(F, F_dot):
    """With a third column n of unit length, F is a 3x3 gradient: I1 + 1, I2 + 1 and J = I3.

    Their gradients are those of the solid without the third column; dI1/dF is its rotation.
    """
    U, s, V = membrane(F)
    normal = np.cross(F[:, 0], F[:, 1]) / np.linalg.norm(np.cross(F[:, 0], F[:, 1]))
    solid = np.column_stack([F, normal])
    stretches = sd.signed_svd(solid)[1]
    I1, I2, I3 = mi.invariants(s)
    close(np.array([stretches.sum(), (stretches**2).sum(), stretches.prod()]), [I1 + 1, I2 + 1, I3])
    gradients = mi.gradients(U, s, V)
    close(gradients[0], po.polar(solid).R[:, :2])
    close(gradients[2], (np.linalg.det(solid) * np.linalg.inv(solid).T)[:, :2])
    # Twists and tilts turn the normal along: H1 : F_dot is the change of the rotation's columns.
    rate = mi.normal_velocity(U, s, V, F_dot)[1] * np.sign(U[:, 2] @ normal)
    dR = po.rotation_differential(solid, np.column_stack([F_dot, rate]))
    close(mi.hessian_products(U, s, V, F_dot)[0], dR[:, :2])
    close(dR[:, 2], rate)


@pytest.mark.capability(28)
@law
@given(shaped(3, 2), shaped(3, 2))
def test_split_of_a_perturbation(F, F_dot):
    """1.1: one part leaves the normal, the other turns only it, by wx = f/s_2 and wy = -e/s_1."""
    U, s, V = membrane(F)
    assume(s[0] - s[1] > 0.05)
    in_plane, tilt = mi.split(U, V, F_dot)
    close(in_plane + tilt, F_dot, 1e-14)
    first, second = mi.rates(U, s, V, in_plane), mi.rates(U, s, V, tilt)
    assert np.abs(first.omega[:2]).max() < 1e-13
    assert abs(second.omega[2]) < 1e-13 and np.abs(second.s_dot).max() < 1e-14
    M = U.T @ F_dot @ V
    close(second.omega[:2], [M[2, 1] / s[1], -M[2, 0] / s[0]], 1e-13)


@pytest.mark.capability(26)
@law
@given(shaped(2, 2))
def test_the_other_second_invariant(A):
    """Footnote 1: 1/2 (tr(A)^2 - tr(A^2)) is det A, I3 of a stretch; |A|_F^2 needs symmetry."""
    close(mi.second_invariant(A), np.linalg.det(A), 1e-14)
    close(mi.second_invariant(A @ A.T, as_printed=True), np.linalg.det(A) ** 2, 1e-13)
    lost = mi.second_invariant(A) - mi.second_invariant(A, as_printed=True)
    close(lost, (A[0, 1] - A[1, 0]) ** 2 / 2, 1e-14)
    stretch = mi.svd(np.vstack([A, [0, 0]]))[1]
    close(abs(mi.second_invariant(A)), mi.invariants(stretch)[2], 1e-13)


# Document 002


@pytest.mark.capability(40)
@law
@given(shaped(3, 3), shaped(3, 3), GROUPS, seeds)
def test_polar_energy_turns_with_the_body(F, A, group, seed):
    """Psi(Q F) = Psi(F), P(Q F) = Q P(F), and H turns; Psi(F Q, Q^T A Q) = Psi(F, A)."""
    Q = random_rotation(np.random.default_rng(seed))
    s = po.polar(F @ A, group).s
    assume(s[1] + s[2] > 0.05 and abs(s[2]) > 1e-3)
    close(po.energy(Q @ F, A, group), po.energy(F, A, group), 1e-12)
    close(po.energy(Q @ F @ Q.T, Q @ A @ Q.T, group), po.energy(F, A, group), 1e-12)
    close(po.energy_traces(F, A, group), po.energy(F, A, group), 1e-12)
    close(po.first_piola(Q @ F, A, group), Q @ po.first_piola(F, A, group))
    H = po.hessian(F, A, group)
    close(po.hessian(Q @ F, A, group), np.einsum("ia,kc,ajcl->ijkl", Q, Q, H, optimize=True), 1e-10)
    close(H, np.transpose(H, (2, 3, 0, 1)), 1e-11)
    close(po.hessian_product(F, A, F, group), 2 * F @ A @ A.T, 1e-10)


@law
@given(shaped(3, 3), seeds)
def test_polar_energy_is_arap(F, seed):
    """A = I: |F - R|^2 is the as-rigid-as-possible energy of document 000 with mu = 1."""
    U, s, V = sd.signed_svd(state("arap", F))
    energy, identity = qu.arap(1.0), np.eye(3)
    close(po.energy(F, identity), energy.value(s), 1e-12)
    close(po.first_piola(F, identity), sd.first_piola(energy, F), 1e-12)
    close(po.hessian(F, identity), sd.tangent(U, V, *sd.tangent_blocks(energy, s)), 1e-10)
    close(
        np.sort(po.identity_eigenvalues(F)),
        np.linalg.eigvalsh(sd.to_matrix(po.hessian(F, identity))),
    )


@pytest.mark.capability(45)
@law
@given(shaped(3, 3), shaped(3, 3), GROUPS)
def test_spins_solve_the_sylvester_equation(G, dG, group):
    """Omega S + S Omega = R^T dG - dG^T R, solved as 9 linear equations; dS is what is left."""
    p = po.polar(G, group)
    assume(p.s[1] + p.s[2] > 0.05)
    operator = np.kron(np.eye(3), p.S) + np.kron(p.S, np.eye(3))
    twist = p.R.T @ dG - dG.T @ p.R
    wanted = np.linalg.solve(operator, twist.ravel()).reshape(3, 3)
    close(po.angular_velocity(G, dG, group), wanted, 1e-10)
    close(po.stretch_differential(G, dG, group), p.R.T @ dG - wanted @ p.S, 1e-10)


# Leading axes

MEMBRANE = {
    "invariants": lambda F, D, mu, U, s, V: mi.invariants(s),
    "rates": lambda F, D, mu, U, s, V: mi.rates(U, s, V, D),
    "velocity": lambda F, D, mu, U, s, V: mi.velocity(s, mi.rates(U, s, V, D)),
    "rotation_rates": lambda F, D, mu, U, s, V: mi.rotation_rates(U, V, mi.rates(U, s, V, D)),
    "velocity_sum": lambda F, D, mu, U, s, V: mi.velocity_sum(U, s, V, U, s, V),
    "split": lambda F, D, mu, U, s, V: mi.split(U, V, D),
    "normal_velocity": lambda F, D, mu, U, s, V: mi.normal_velocity(U, s, V, D),
    "gradients": lambda F, D, mu, U, s, V: mi.gradients(U, s, V),
    "hessian_products": lambda F, D, mu, U, s, V: mi.hessian_products(U, s, V, D),
    "second_invariant": lambda F, D, mu, U, s, V: mi.second_invariant(V * mu[..., None, None]),
    "energy_gradient": lambda F, D, mu, U, s, V: mi.energy_gradient(U, s, V, D[..., 0]),
    "energy_hessian": lambda F, D, mu, U, s, V: mi.energy_hessian(U, s, V, D[..., 0], U),
    "to_matrix": lambda F, D, mu, U, s, V: mi.to_matrix(mi.hessians(U, s, V)),
    "solid_gradient": lambda F, D, mu, U, s, V: me.solid_gradient(F),
    "sheet": lambda F, D, mu, U, s, V: me.sheet(F, mu),
    "sheet_gradient": lambda F, D, mu, U, s, V: me.sheet_gradient(U, s, V, mu),
    "sheet_hessian": lambda F, D, mu, U, s, V: me.sheet_hessian(U, s, V, mu),
    "sheet_hessian_printed": lambda F, D, mu, U, s, V: me.sheet_hessian(U, s, V, mu, True),
    "sheet_hessian_short": lambda F, D, mu, U, s, V: me.sheet_hessian_short(U, s, V, mu),
    "reduced_hessian": lambda F, D, mu, U, s, V: me.reduced_hessian(s, mu),
    "reduced_basis": lambda F, D, mu, U, s, V: me.reduced_basis(U, V),
    "reduced_eigenpairs": lambda F, D, mu, U, s, V: me.reduced_eigenpairs(s, mu),
    "last_eigenpairs": lambda F, D, mu, U, s, V: me.last_eigenpairs(U, s, V, mu, True),
    "projected_hessian": lambda F, D, mu, U, s, V: me.projected_hessian(U, s, V, mu),
}
POLAR = {
    "polar": lambda F, A, D: po.polar(F),
    "factor_rates": lambda F, A, D: po.factor_rates(F, D),
    "stretch_rates": lambda F, A, D: po.stretch_rates(F, D),
    "stretch_differential": lambda F, A, D: po.stretch_differential(F, D),
    "angular_velocity": lambda F, A, D: po.angular_velocity(F, D),
    "energy": lambda F, A, D: po.energy(F, A),
    "energy_traces": lambda F, A, D: po.energy_traces(F, A),
    "first_piola": lambda F, A, D: po.first_piola(F, A),
    "hessian_product": lambda F, A, D: po.hessian_product(F, A, D),
    "hessian": lambda F, A, D: po.hessian(F, A),
    "hessian_printed": lambda F, A, D: po.hessian(F, A, as_printed=True),
    "identity_eigenvalues": lambda F, A, D: po.identity_eigenvalues(F),
}


def same(several, one):
    """What the states give together is at [1, 2] what the last gives alone."""
    if isinstance(one, tuple):
        for x, y in zip(several, one, strict=True):
            same(x, y)
        return
    assert several.shape == (2, 3, *one.shape)
    close(several[1, 2], one, 1e-14)


@pytest.mark.parametrize("name", MEMBRANE)
def test_leading_axes_of_membranes(name, rng):
    F = np.eye(3, 2) + 0.3 * rng.normal(size=(2, 3, 3, 2))
    arguments = F, rng.normal(size=F.shape), rng.uniform(1, 2, (2, 3)), *mi.svd(F)
    same(MEMBRANE[name](*arguments), MEMBRANE[name](*(x[1, 2] for x in arguments)))


@pytest.mark.parametrize("name", POLAR)
def test_leading_axes_of_polar_decompositions(name, rng):
    arguments = np.eye(3) + 0.3 * rng.normal(size=(3, 2, 3, 3, 3))
    same(POLAR[name](*arguments), POLAR[name](*arguments[:, 1, 2]))


def test_every_pair_is_listed_once():
    """PAIRS and ORDER name each entry of F once."""
    for d, pairs in qu.PAIRS.items():
        assert sorted(pairs) == list(itertools.combinations(range(d), 2))
        assert sorted(sd.ORDER[d]) == list(range(d * d))
