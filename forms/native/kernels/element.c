/* SPDX-License-Identifier: MIT */
/* A linear triangle with one point, in place of the text that Python writes for each element: with it
   other compilers see the loops over cells. */
#define NODES 3
#define POINTS 1
#define SIZE 2
#define DIM 2
#define CORNERS 3
#define SETS 1
static const double G[POINTS][NODES][DIM] = {{{-1, -1}, {1, 0}, {0, 1}}};
#include "moduli.h"

#include "cells.h"
