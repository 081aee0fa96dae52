# SPDX-License-Identifier: MIT
"""An estimate of a billion unknowns on a cluster, from the pieces that ``scaling.py`` measures.

Measured on one core: seconds of each piece per unknown. Measured on two: messages, bytes and
reductions of each piece. Assumed: the cluster, in the constants below, and subdomains that are
cubes. The rest follows:

A piece on n unknowns: seconds per unknown * n * slow + messages * exchange + reductions * allreduce
slow:       bytes per second of a product with K here, over a core's share of its node's memory
exchange:   LATENCY + (NEIGHBORS - 1) MESSAGE + halo / a core's share of the network
halo:       6 (n/3)^(2/3) nodes in each of as many layers as measured, on level l with n / r^l
allreduce:  2 LATENCY log2(cores)
"""

from math import ceil, log, log2

import numpy as np

from .record import markdown

UNKNOWNS = 1e9
CORES = (1_000, 10_000, 50_000)
# Round figures of nodes with two sockets, and of a network of 200 Gbit/s.
CORES_PER_NODE = 128
NODE_MEMORY = 256e9  # B
NODE_BANDWIDTH = 400e9  # B/s, to memory
NETWORK = 25e9  # B/s, of a node
LATENCY = 1.5e-6  # s
MESSAGE = 0.3e-6  # s, for each more that is under way
NEIGHBORS = 26
STORED = 12  # bytes that a product reads for each stored number: the number and its column
CELLS_PER_UNKNOWN = 2  # of tetrahedra of degree 1: six for a node
INDICES = 2**31 - 1  # largest number of a row, and of a rank's stored numbers, in 32 bits
DOTS = 3  # reductions of a CG iteration


class Estimate:
    """Times of a problem on a cluster.

    Args:
        rows: What was measured, as in ``results/scaling.csv``.

    Attributes:
        slow: How much longer memory-bound pieces take on a core of a full node.
        layers: Layers of nodes that a product with K needs of a neighbor.
        levels: Levels of multigrid at UNKNOWNS; ``ratio`` is that of unknowns from one to the next.
        growth: CG iterations at UNKNOWNS over those measured.
    """

    def __init__(self, rows):
        strong = [r for r in rows if r["what"] == "strong" and r["element"] == "P1"]
        self.one, self.two = (next(r for r in strong if r["ranks"] == n) for n in (1, 2))
        self.mesh = next(r for r in rows if r["what"] == "mesh")
        one, two = self.one, self.two
        here = STORED * one["stored"] / one["SpMV [s]"]
        self.slow = max(1.0, here / (NODE_BANDWIDTH / CORES_PER_NODE))
        self.layers = two["SpMV [B]"] / (24 * (two["m"] + 1) ** 2)
        self.ratio = (one["dofs"] / one["coarsest"]) ** (1 / (one["levels"] - 1))
        self.levels = 1 + ceil(log(UNKNOWNS / one["coarsest"]) / log(self.ratio))
        self.growth = self._iterations(rows) / one["iterations"]

    def _iterations(self, rows):
        """CG iterations at UNKNOWNS: as many more each time the unknowns double as measured."""
        found = [r for r in rows if r.get("element") == "P1" and r["what"] in ("strong", "weak")]
        sizes, counts = np.log2([r["dofs"] for r in found]), [r["iterations"] for r in found]
        slope, start = np.polyfit(sizes, counts, 1)
        return max(start + slope * log2(UNKNOWNS), self.one["iterations"])

    def halo(self, n):
        """Bytes that a core with n unknowns gets for a product with K."""
        return 6 * max(n / 3, 1) ** (2 / 3) * self.layers * 24

    def exchange(self, n):
        """Seconds of one exchange of the halo."""
        share = NETWORK / CORES_PER_NODE
        return LATENCY + (NEIGHBORS - 1) * MESSAGE + self.halo(n) / share

    def waiting(self, piece, cores):
        """Seconds in which a piece waits for the network."""
        n, measured = UNKNOWNS / cores, self.two["levels"] - 1
        reductions = self.two[f"{piece}, reductions"]
        if piece == "SpMV":
            found = self.exchange(n)
        else:
            each = self.two[f"{piece}, messages"] / measured
            below = range(self.levels - 1)
            found = sum(each * self.exchange(n / self.ratio**level) for level in below)
        if piece == "set-up":
            reductions *= (self.levels - 1) / measured
        return found + reductions * self.allreduce(cores)

    def allreduce(self, cores):
        """Seconds of a sum over all cores."""
        return 2 * LATENCY * log2(cores)

    def times(self, cores):
        """Seconds of each piece."""
        one, n = self.one, UNKNOWNS / cores
        share = n / one["dofs"]
        assembly = share * (one["residual [s]"] + one["tangent [s]"]) + 2 * self.exchange(n)
        pieces = {
            name: share * self.slow * one[f"{name} [s]"] + self.waiting(name, cores)
            for name in ("SpMV", "V-cycle", "set-up")
        }
        waiting = sum(self.waiting(name, cores) for name in ("SpMV", "V-cycle"))
        waiting += DOTS * self.allreduce(cores)
        each = one["solve [s]"] / one["iterations"]
        iteration = share * self.slow * each + waiting
        rest = one["step [s]"] - one["linear"] * each - one["set-up [s]"]
        step = share * rest + self.growth * one["linear"] * iteration + pieces["set-up"]
        return {"assembly": assembly, **pieces, "iteration": iteration, "step": step} | {
            "waiting": waiting / iteration
        }

    def memory(self, cores):
        """Bytes that a node holds."""
        one = self.one
        each = (one["memory [MB]"] - one["memory before [MB]"]) / one["dofs"]
        ranks = min(CORES_PER_NODE, cores)
        return 2**20 * ranks * (one["memory before [MB]"] + each * UNKNOWNS / cores)

    def half(self):
        """Cores from which on a CG iteration waits for half its time."""
        low, high = 1.0, UNKNOWNS
        while high > 1.01 * low:
            middle = (low * high) ** 0.5
            low, high = (low, middle) if self.times(middle)["waiting"] > 0.5 else (middle, high)
        return low

    def limits(self):
        """What ends, and at how many unknowns, smallest first."""
        mesh = self.mesh
        making = 2**20 * (mesh["memory [MB]"] - mesh["memory before [MB]"]) / mesh["cells"]
        keeping = mesh["checkpoint [B]"] / mesh["cells"]
        found = {
            f"memory of rank 0, which makes and checks the mesh ({making:,.0f} B per cell)": (
                NODE_MEMORY / making / CELLS_PER_UNKNOWN
            ),
            f"memory of rank 0, which puts checkpoints in order ({keeping:,.0f} B per cell)": (
                NODE_MEMORY / keeping / CELLS_PER_UNKNOWN
            ),
            "numbers of rows, in PETSc's integers of 32 bits": INDICES,
        }
        return sorted(found.items(), key=lambda item: item[1])


def lines(rows):
    """Markdown: the estimate, and what ends first."""
    e = Estimate(rows)
    found = [e.times(cores) for cores in CORES]
    n = [UNKNOWNS / cores for cores in CORES]
    table = {
        "unknowns per core": [f"{x:,.0f}" for x in n],
        "nodes": [f"{ceil(cores / CORES_PER_NODE):,}" for cores in CORES],
        f"GB per node, of {NODE_MEMORY / 1e9:.0f}": [
            f"{e.memory(cores) / 1e9:.0f}" for cores in CORES
        ],
        "halo of a product with K, kB": [f"{e.halo(x) / 1e3:.0f}" for x in n],
        "residual and tangent, s": [f"{t['assembly']:.2g}" for t in found],
        "product with K, ms": [f"{1e3 * t['SpMV']:.2g}" for t in found],
        "V-cycle, ms": [f"{1e3 * t['V-cycle']:.2g}" for t in found],
        "CG iteration, ms": [f"{1e3 * t['iteration']:.2g}" for t in found],
        "of it waiting": [f"{100 * t['waiting']:.0f} %" for t in found],
        "set-up of multigrid, s": [f"{t['set-up']:.2g}" for t in found],
        "load step, s": [f"{t['step']:.2g}" for t in found],
    }
    ends = [(what, f"{at:.1e}") for what, at in e.limits()]
    stored = e.one["stored"] / e.one["dofs"]
    half = f"{float(f'{e.half():.1g}'):,.0f}"
    return [
        *markdown(
            ["estimate, cores", *(f"{cores:,}" for cores in CORES)],
            [[name, *cells] for name, cells in table.items()],
        ),
        "",
        f"{e.levels} levels ({e.one['levels']} measured), {e.growth:.1f} times the CG iterations "
        f"measured, {e.slow:.1f} times the seconds where memory bounds. From about {half} cores on "
        f"half of each CG iteration is waiting. A rank stores at most {INDICES:.1e} "
        f"numbers, {stored:.0f} in a row: {INDICES / stored:.0e} rows.",
        "",
        *markdown(["what ends", "at unknowns, about"], ends),
    ]
