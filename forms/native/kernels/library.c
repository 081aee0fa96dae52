/* SPDX-License-Identifier: MIT */
/* Everything that Python loads: point kernels over arrays, the kernels of cells and facets, insertion,
   sums over cells, multigrid's coarse operators and smoother, bounds of the volume ratio. */
#include "points.c"

#include "cell.h"
#include "insertion.h"
#include "products.h"
#include "sums.h"
#include "sweeps.h"
#include "validity.h"

/* What Python declares again: the sizes of the structures, and limits (native/library.py). */
const long declared[] = {sizeof(operator_t), sizeof(jet_t),  sizeof(integral_t), sizeof(target_t),
                         sizeof(part_t),     sizeof(geometry_t), sizeof(validity_t), sizeof(sweeps_t),
                         sizeof(rows_t),     sizeof(block_rows_t),
                         sizeof kernels / sizeof *kernels, MAX_OPERATORS, MAX_PIECES, PARAMETERS,
                         TOGETHER, MAX_PARTS, MAX_LINE, MODES};
