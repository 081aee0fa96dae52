/* SPDX-License-Identifier: MIT */
/* Everything that Python loads: point kernels over arrays, the kernels of cells and facets, insertion. */
#include "points.c"

#include "cell.h"
#include "insertion.h"
