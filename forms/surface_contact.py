# SPDX-License-Identifier: MIT
"""Contact of deformable surfaces, with each other and with themselves; no friction here.

A term of a potential: barriers between points, segments and triangles that come nearer than dhat,
with exact derivatives, and continuous collision detection that lets no step pass a surface through
another. By ipctk (Li et al., ACM Trans. Graph. 39 (2020) 49), an optional package.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from numpy.typing import NDArray

from . import _checks
from ._types import Expr
from .boundaries import sizes
from .surfaces import Surface
from .unknowns import field_of

FINE = 0.1  # of the smallest facet: default reach of the barrier
KEPT = 0.9  # of the way to a collision that a step may go
# Of pairs, as ipctk has them and in its order.
KINDS = {"vv": "vertex_vertex", "ev": "edge_vertex", "ee": "edge_edge", "fv": "face_vertex"}


class Touching:
    """Surfaces that pass neither through each other nor through themselves: a term of a potential.

    ``forms.solve([psi * ufl.dx, forms.touching(u, body.ds("top", "below"))], u, …)``

    sum w b(d) over pairs of points and triangles, and of edges, nearer than dhat, w an area and b
    IPC's barrier; see :func:`touching`.

    Attributes:
        name: Of the contact.
        measures: Where it acts.
        surface: Points and pieces.
        dhat: Reach [m].
        stiffness: Pressure scale [Pa].
        unknown: The unknown.
        ipc, mesh, potential: ipctk, and the surface and its barrier as ipctk has them.
        couples: True: its tangent joins nodes that no cell joins.
        majorized: Whether its tangent is projected always, for solvers that need a definite one.
    """

    couples = True
    majorized = False

    def __init__(
        self,
        u: Expr,
        ds: Any,
        dhat: float | None,
        stiffness: float,
        thickness: float,
        parts: Any,
        name: str,
    ) -> None:
        self.ipc = _ipctk()
        w, field = field_of(u, "contact")
        if not field.is_displacement:
            raise ValueError(f"contact needs the displacement, got the field {field.name}.")
        listed = list(ds) if isinstance(ds, list | tuple) else [ds]
        mesh = w.function_space.mesh
        measures = [_checks.measure(each, "contact") for each in listed]
        measures = [
            each if each.ufl_domain() is not None else each(domain=mesh) for each in measures
        ]
        smallest = min(sizes(mesh, each)[0] for each in measures)
        if parts is None:
            parts = 3 if field.degree == 1 else 4
        if not isinstance(parts, int) or parts < 1:
            raise ValueError(f"parts of contact is a whole number of at least 1, got {parts}.")
        dhat = FINE * smallest / parts if dhat is None else dhat
        if not (_checks.number(dhat) is not None and 0 < dhat <= smallest):
            raise ValueError(
                f"dhat of contact is a length above 0 and up to the smallest facet, "
                f"{smallest:.4g}, got {dhat}: a tenth of the facets is the default."
            )
        if not (_checks.number(stiffness) is not None and 0 < stiffness < np.inf):
            raise ValueError(
                f"the stiffness of contact is a pressure above 0 [Pa], got {stiffness}."
            )
        if not (_checks.number(thickness) is not None and 0 <= thickness < np.inf):
            raise ValueError(f"a thickness is not negative, got {thickness}.")
        self.dhat, self.stiffness, self.thickness = float(dhat), float(stiffness), float(thickness)
        self.unknown, self._comm = w, mesh.comm
        self.name, self.measures = name, tuple(measures)
        self.surface = Surface(w, field, measures, parts)
        ipc, surface = self.ipc, self.surface
        self.mesh = ipc.CollisionMesh(surface.points, surface.edges, surface.faces)
        # The barrier has the unit of a pressure times a length, whatever dhat is.
        self.potential = ipc.BarrierPotential(self.dhat, self.stiffness, True)
        # Additive CCD: tight inclusion bisects parallel faces for minutes.
        self._ccd = ipc.AdditiveCCD()
        self._x: NDArray = np.empty((0, 0))
        self._last = surface.places()
        self._pairs = self._shared = self._own = ipc.NormalCollisions()

    def begin(self) -> None:
        """Take the present state for a start. Collective.

        Raises:
            ValueError: surfaces cross there, or touch.
        """
        x = self.surface.places()
        place = self._crossing(x)
        if place:
            raise ValueError(
                f"surfaces cross or touch at the start, at {place}: begin with a gap between them, "
                "or move one by a support first."
            )
        self._last = x

    def _crossing(self, x: NDArray) -> str:
        """Where surfaces cross, or are no further apart than the thickness; empty for nowhere."""
        ipc = self.ipc
        pairs = ipc.NormalCollisions()
        pairs.build(self.mesh, x, self.dhat, self.thickness)
        least = np.inf
        if not pairs.empty():
            least = float(np.sqrt(max(pairs.compute_minimum_distance(self.mesh, x), 0.0)))
        bad = bool(ipc.has_intersections(self.mesh, x)) or not least > self.thickness
        if not self._comm.bcast(bad, root=0):
            return ""
        pieces = self.mesh.edges, self.mesh.faces
        near = sorted(
            (pairs[k].compute_distance(x, *pieces), k) for k in range(len(pairs))
        )  # where they cross they are nearest
        ids = pairs[near[0][1]].vertex_ids(*pieces) if near else range(len(x))
        at = x[[i for i in ids if i >= 0]].mean(axis=0)
        at = self._comm.bcast(at, root=0)
        return f"({', '.join(f'{c:.4g}' for c in at)})"

    def prepare(self) -> None:
        """Find the pairs that are near at the present state. Collective."""
        x = self.surface.places()
        if self._x.shape != x.shape or not np.array_equal(self._x, x):
            self._x, self._pairs = x, self.pairs_at(x)

    def pairs_at(self, x: NDArray) -> Any:
        """Pairs of pieces nearer than dhat, weighted by areas, where the points are at x; local."""
        pairs = self.ipc.NormalCollisions()
        pairs.use_area_weighting = True
        pairs.collision_set_type = self.ipc.NormalCollisions.IMPROVED_MAX_APPROX
        pairs.build(self.mesh, x, self.dhat, self.thickness)
        return pairs

    def share_of(self, pairs: Any) -> Any:
        """This rank's share of pairs that all ranks have found; local."""
        return share(pairs, self._comm.rank, self._comm.size)

    @property
    def _share(self) -> Any:
        """The share of the pairs at the state that was prepared; made once, where it is needed."""
        if self._shared is not self._pairs:
            self._shared, self._own = self._pairs, self.share_of(self._pairs)
        return self._own

    def energy(self) -> float:
        """Barrier energy [J]. Collective.

        Of all pairs, on every rank: a share takes longer to be taken out than this.
        """
        if not np.all(np.isfinite(self._x)):
            return np.inf
        own = float(self.potential(self._pairs, self.mesh, self._x))
        return float(self._comm.bcast(own, root=0))

    def forces(self) -> NDArray:
        """Derivative of the energy of this rank's share by the points' places [N], (n, dim)."""
        g = self.potential.gradient(self._share, self.mesh, self._x)
        return np.asarray(g).reshape(self._x.shape)

    def gaps(self) -> NDArray:
        """Distance of each point's pieces to others, less the thickness [m]; dhat where farther."""
        found = np.full(len(self._x), self.dhat)
        pieces = self.mesh.edges, self.mesh.faces
        for k in range(len(self._pairs)):
            pair = self._pairs[k]
            ids = [i for i in pair.vertex_ids(*pieces) if i >= 0]
            d = float(np.sqrt(pair.compute_distance(self._x, *pieces)))
            found[ids] = np.minimum(found[ids], d - self.thickness)
        return found

    def acting(self) -> NDArray:
        """Owned degrees of freedom that it acts on at the state that was prepared. Collective."""
        numbers, values = self.surface.own_forces(np.abs(self.forces()))
        return np.asarray(numbers[values != 0])

    def residual(self, b: PETSc.Vec) -> None:
        """Add the derivative of the energy. Collective."""
        numbers, values = self.surface.own_forces(self.forces())
        with b.localForm() as local:
            local.array[numbers] += values

    def coupling(self, A: PETSc.Mat, projected: bool = False) -> PETSc.Mat:
        """Second derivative of the energy, of A's layout; a matrix of its own. Collective.

        Projected pair by pair, those left out that are counted off: the sum has to be positive.
        """
        ways = self.ipc.PSDProjectionMethod
        how, pairs = ways.NONE, self._share
        if projected or self.majorized:
            how, pairs = ways.CLAMP, added(pairs)
        H = self.potential.hessian(pairs, self.mesh, self._x, how)
        return self.surface.stiffness(H, A)

    def largest_step(self, step: PETSc.Vec) -> float:
        """Fraction of a step before surfaces meet, nine tenths of it. Collective."""
        own = step.array_r
        move = self.surface.gathered(np.pad(own, (0, len(self.unknown.x.array) - len(own))))
        x = self.surface.places()
        return self._free(x, np.asfortranarray(x + move))

    def _free(self, x: NDArray, to: NDArray) -> float:
        if not np.all(np.isfinite(to)):
            return 1.0
        how = self.thickness, None, self._ccd
        found = self.ipc.compute_collision_free_stepsize(self.mesh, x, to, *how)
        found = 1.0 if found >= 1 else KEPT * found
        return float(self._comm.bcast(found, root=0))

    def crossed(self) -> str:
        """What the way from the last accepted state to u passes through, in words. Collective."""
        x = self.surface.places()
        if np.array_equal(x, self._last):
            return ""
        how = self.thickness, None, self._ccd
        free = self.ipc.is_step_collision_free(self.mesh, self._last, x, *how)
        return "" if self._comm.bcast(bool(free), root=0) else "surfaces would pass each other"

    def certified(self) -> bool:
        """Whether no two pieces cross at u, by a check that knows no way there. Collective."""
        found = not self.ipc.has_intersections(self.mesh, self.surface.places())
        return bool(self._comm.bcast(found, root=0))

    def near(self) -> bool:
        """Whether any pair is nearer than dhat at u. Collective."""
        self.prepare()
        return self.joins()

    def joins(self) -> bool:
        """Whether its tangent has entries at the state that was prepared. Collective."""
        return bool(self._comm.bcast(not self._pairs.empty(), root=0))

    def tangent(self, A: PETSc.Mat, projected: bool = False) -> None:
        """Nothing: it has entries where A has none, see :meth:`coupling`."""

    def commit(self) -> None:
        """Take the present state for the last accepted one. Collective."""
        self._last = self.surface.places()

    def rollback(self) -> None:
        """Take the present state, the last accepted one, for where the next way begins."""
        self.prepare()
        self._last = self._x

    def history(self) -> dict[str, NDArray]:
        """Nothing besides the unknown."""
        return {}


def share(pairs: Any, rank: int, size: int) -> Any:
    """A rank's share of pairs: of each kind some that stand in a row. Local.

    All ranks have the same pairs in the same order, since they have the same places to the bit, and
    one thread each.

    Args:
        pairs: ipctk's NormalCollisions.
        rank: Whose share.
        size: Number of ranks.
    """
    if size == 1:
        return pairs
    own, first = type(pairs)(), 0
    own.use_area_weighting = pairs.use_area_weighting
    own.collision_set_type = pairs.collision_set_type
    for kind, name in KINDS.items():
        # ipctk's own lists are of all pairs: to make them takes as long on any number of ranks.
        is_other = _without(getattr(pairs, f"is_{name}"))
        end = bisect_left(range(len(pairs)), True, lo=first, key=is_other)
        n = end - first
        mine = range(first + n * rank // size, first + n * (rank + 1) // size)
        setattr(own, f"{kind}_collisions", [pairs[k] for k in mine])
        first = end
    return own


def added(pairs: Any) -> Any:
    """The pairs of positive weight; the others take off what several pairs have in common. Local.

    Args:
        pairs: ipctk's NormalCollisions.
    """
    found = type(pairs)()
    found.use_area_weighting = pairs.use_area_weighting
    found.collision_set_type = pairs.collision_set_type
    for kind in KINDS:
        listed = getattr(pairs, f"{kind}_collisions")
        setattr(found, f"{kind}_collisions", [pair for pair in listed if pair.weight > 0])
    return found


def _without(holds: Callable[[int], bool]) -> Callable[[int], bool]:
    return lambda k: not holds(k)


def touching(
    u: Expr,
    ds: ufl.Measure | Sequence[ufl.Measure],
    stiffness: float,
    dhat: float | None = None,
    thickness: float = 0.0,
    parts: int | None = None,
    name: str = "surfaces",
) -> Touching:
    """Contact of surfaces with each other and with themselves. Collective.

    :func:`forms.friction` of it is friction, in motions.

    Args:
        u: Displacement [m]; of a mixed unknown w["u"].
        ds: Boundaries that may touch, as ``body.ds("upper", "lower")``; of membranes ``ufl.dx``.
        stiffness: Pressure scale of the barrier [Pa]: about a tenth of the body's modulus.
        dhat: Distance from which on the barrier acts [m]; by default a tenth of the smallest part
            of a facet.
        thickness: Distance that is kept from middle to middle of sheets [m].
        parts: Parts of each edge of a facet, flat pieces between points, among which forces are
            shared out by area: more of them make the pressure smoother. By default 3 for linear
            elements, and 4 for others.
        name: By which :mod:`forms.contact` finds it.

    Returns:
        Term to be passed in a list with the potential, ``[psi * ufl.dx, term]``. Forces and tangent
        are evaluated in shares of the pairs, one for each rank. All ranks know the whole surface,
        find all its pairs, and search each step for collisions: that does not get faster
        (demos/benchmarks/README.md has figures).

    Raises:
        ImportError: ipctk is missing.
        ValueError: an argument of the wrong kind, or dhat larger than the smallest facet.
    """
    return Touching(u, ds, dhat, stiffness, thickness, parts, name)


def _ipctk() -> Any:
    try:
        import ipctk
    except ImportError as error:
        raise ImportError(
            "contact of surfaces needs ipctk, which is not installed: pip install ipctk==1.6.0 "
            "(later ones need processors with AVX-512); rigid obstacles, forms.obstacle, need none."
        ) from error
    ipctk.set_num_threads(1)  # alike on all ranks, which are the threads
    return ipctk
