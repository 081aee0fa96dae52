/* SPDX-License-Identifier: MIT */
/* Everything that Python loads: point kernels over arrays, and the kernels of cells and facets. */
#include "points.c"

#include "cell.h"
