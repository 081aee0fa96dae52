/* SPDX-License-Identifier: MIT */
/* The signature of FFCx's kernels. */
#ifndef VARIFORM_KERNEL_H
#define VARIFORM_KERNEL_H

#include <stdint.h>

#ifdef VARIFORM_CUSTOM_DATA /* FFCx kernels of DOLFINx >= 0.10 take one more argument */
typedef void (*tabulate_t)(double *, const double *, const double *, const double *, const int *,
                           const uint8_t *, void *);
#define VARIFORM_CUSTOM , 0
#else
typedef void (*tabulate_t)(double *, const double *, const double *, const double *, const int *,
                           const uint8_t *);
#define VARIFORM_CUSTOM
#endif

#endif
