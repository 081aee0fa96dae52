# SPDX-License-Identifier: MIT
"""A path of the fidelity benchmark in FElupe: its elements, its Newton method with its defaults.

``python demos/benchmarks/peers/felupe_paths.py FILE`` reads mesh, supports and energy of FILE, an
archive of NumPy that fidelity_felupe.py writes, takes the steps until one does not converge, and
writes the last displacements to FILE.npy. Linear systems are solved by PARDISO.
"""

import json
import sys
import time

import felupe
import numpy as np
from pypardiso import spsolve
from tensortrax.math import log, sqrt, trace
from tensortrax.math.linalg import det

REGIONS = {
    ("tetrahedron", 1): (felupe.RegionTetra, felupe.Tetra, "tetra"),
    ("tetrahedron", 2): (felupe.RegionQuadraticTetra, felupe.QuadraticTetra, "tetra10"),
    ("hexahedron", 1): (felupe.RegionHexahedron, felupe.Hexahedron, "hexahedron"),
    ("hexahedron", 2): (
        felupe.RegionTriQuadraticHexahedron,
        felupe.TriQuadraticHexahedron,
        "hexahedron27",
    ),
}


def stable_neo_hookean(C, mu, lmbda):
    """Variform's ``energies.stable_neo_hookean`` of C."""
    m, k = 4 * mu / 3, lmbda + 5 * mu / 6
    volume = (sqrt(det(C)) - 1 - 3 * m / (4 * k)) ** 2
    return m / 2 * trace(C) + k / 2 * volume - m / 2 * log(trace(C) + 1)


def saint_venant_kirchhoff(C, mu, lmbda):
    """Mu E : E + lmbda/2 (tr E)^2."""
    # E : E of E = (C - I)/2 in the invariants of C.
    return mu / 4 * (trace(C @ C) - 2 * trace(C)) + lmbda / 8 * (trace(C) - 3) ** 2


def mooney_rivlin(C, kappa):
    """0.3 (I1 - 3) + 0.2 (I2 - 3) of the isochoric C, and kappa/2 (J - 1)^2."""
    J = sqrt(det(C))
    I1, I2 = J ** (-2 / 3) * trace(C), J ** (-4 / 3) * (trace(C) ** 2 - trace(C @ C)) / 2
    return 0.3 * I1 + 0.2 * I2 + kappa / 2 * (J - 1) ** 2


def material(name, number):
    """The energy of a scene."""
    if name == "neo_hookean":
        return felupe.NeoHookeCompressible(mu=1.0, lmbda=number)
    if name == "mooney_rivlin":
        return felupe.Hyperelastic(mooney_rivlin, kappa=number)
    energy = {"stable_neo_hookean": stable_neo_hookean}.get(name, saint_venant_kirchhoff)
    return felupe.Hyperelastic(energy, mu=1.0, lmbda=number)


def region(points, cells, kind, degree, reference):
    """FElupe's region; its nodes of a cell are found by their places in the reference cell."""
    make, element, name = REGIONS[kind, degree]
    own = element().points
    own = (own + 1) / 2 if kind == "hexahedron" else own
    order = np.linalg.norm(own[:, None] - reference, axis=-1).argmin(axis=1)
    return make(felupe.Mesh(points, cells[:, order], name))


def main(file):
    """Take the steps, and print how far they came."""
    given = np.load(file)
    kind, degree = str(given["kind"]), int(given["degree"])
    body = region(given["points"], given["cells"], kind, degree, given["reference"])
    field = felupe.FieldContainer([felupe.Field(body, dim=3)])
    solid = felupe.SolidBody(material(str(given["energy"]), float(given["number"])), field)
    tangents, assemble = [], solid.assemble.matrix

    def counted(*positional, **named):
        tangents.append(1)
        return assemble(*positional, **named)

    solid.assemble.matrix = counted
    prescribed = given["prescribed"]
    free = np.setdiff1d(np.arange(field[0].values.size), prescribed)
    steps, reason, last = 0, "", field[0].values.copy()
    start = time.process_time()
    for values in given["values"]:
        try:
            felupe.newtonraphson(
                items=[solid],
                x0=field,
                dof0=prescribed,
                dof1=free,
                ext0=values,
                solver=lambda A, b: spsolve(A.tocsr(), b),
                verbose=0,
            )
        except Exception as error:  # whatever it ends with, the step was not found
            reason = " ".join(str(error).split())
            break
        steps, last = steps + 1, field[0].values.copy()
    row = {"steps": steps, "tangents": len(tangents), "seconds": time.process_time() - start}
    np.save(f"{file}.npy", last)
    print(json.dumps({**row, "reason": reason, "volume": float(body.dV.sum())}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
