/* SPDX-License-Identifier: MIT */
/* Bounds of the volume ratio over whole cells, from Bernstein coefficients (validity.py makes the tables).

   Position in a cell is a polynomial of the reference cell's coordinates, and so are both determinants in
   J = n / d. A polynomial lies between its least and its largest Bernstein coefficient; those at the corners
   are values. Where d > 0, J lies above the least n_i / d_i. Cells that are left open are halved by de
   Casteljau's rule, the part with the least bound first.

   Coefficients times their multinomials convolve in a product: multi-indices add up. Johnen, Remacle,
   Geuzaine, J. Comput. Phys. 233 (2013) 359-372. */
#ifndef VARIFORM_VALIDITY_H
#define VARIFORM_VALIDITY_H

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { SOLID, REVOLVED, SURFACE };
/* Cells at a time, which is what vectorizes; parts of a cell at most; coefficients in a line. */
enum { TOGETHER = 8, MAX_PARTS = 256, MAX_LINE = 16, MAX_DIRECTIONS = 6 };
#define NARROW 0.02 /* width of bounds that is good enough, of |J| or of its range in the cell */

typedef struct {
  int kind, cells;
  int nodes;              /* of a cell */
  int space, dim;         /* coordinates of a point, and of the reference cell */
  const int32_t *numbers; /* of the first coordinate of a cell's nodes in x */
  int rows[4];            /* coefficients of the derivative by each coordinate, and of the position */
  const int32_t *start;   /* entries of each row of the map from nodes to them, multinomials included */
  const int32_t *node;
  const double *entry;
  const double *alone;    /* 1 / multinomial of each row */
  double spread;          /* largest sum of |entries| of a row, without multinomials */
  int terms;              /* numbers that are summed up for one coefficient, at most */
  int inner, outer;       /* coefficients of the first product, and of n */
  const int16_t *first;   /* where the product of two coefficients goes */
  const int16_t *second;
  const double *inverse;  /* 1 / multinomial of each coefficient of n */
  int corners;
  const int16_t *corner;  /* coefficient that is the value there, and the next one along each edge */
  int width;              /* numbers of d that a cell has: 1 where it is constant */
  const double *d;
  const int8_t *side;     /* -1: n and d as they come are those of a mirrored cell */
  int directions;         /* in which a cell is halved */
  const int32_t *begin;   /* their lines: length and coefficients of each */
  const int16_t *lines;
  const int16_t *ends;    /* two vertices that a line goes between, first and last coordinate that differs */
  int vertices;           /* a simplex' own, or the lowest and the highest of a cube */
  const double *vertex;
} validity_t;

/* What fmax() is for numbers, in one instruction. */
static inline double larger(double a, double b)
{
  return a > b ? a : b;
}

/* out += sign f g for all pairs of coefficients. */
static void convolve(const int16_t *to, int nf, int ng, const double *restrict f, const double *restrict g,
                     double sign, double *restrict out)
{
  for (int i = 0; i < nf; i++) {
    double a[TOGETHER];
    for (int l = 0; l < TOGETHER; l++) a[l] = sign * f[i * TOGETHER + l];
    for (int j = 0; j < ng; j++) {
      double *restrict o = out + TOGETHER * to[i * ng + j];
      const double *restrict b = g + j * TOGETHER;
      for (int l = 0; l < TOGETHER; l++) o[l] += a[l] * b[l];
    }
  }
}

/* Largest |coefficient| of some rows, without multinomials. */
static void largest(const double *restrict f, const double *restrict alone, int n, double *restrict g)
{
  for (int i = 0; i < n; i++)
    for (int l = 0; l < TOGETHER; l++) g[l] = larger(fabs(f[i * TOGETHER + l]) * alone[i], g[l]);
}

static void map_nodes(const validity_t *v, int row, int count, const double *restrict z, long stride,
                      double *restrict out)
{
  for (int r = 0; r < count; r++) {
    double sum[TOGETHER] = {0};
    for (int32_t k = v->start[row + r]; k < v->start[row + r + 1]; k++) {
      const double *restrict from = z + stride * v->node[k];
      const double t = v->entry[k];
      for (int l = 0; l < TOGETHER; l++) sum[l] += t * from[l];
    }
    for (int l = 0; l < TOGETHER; l++) out[r * TOGETHER + l] = sum[l];
  }
}

/* Coefficients of n of up to TOGETHER cells, and what rounding may have made of them; an infinite margin: the
   state is not finite. room: TOGETHER times nodes (space + 1) + space (all rows) + 3 inner numbers. */
static void coefficients(const validity_t *v, const double *x, long cell, long count, double *room,
                         double *restrict n, double *restrict margin)
{
  const int space = v->space, dim = v->dim, all = v->rows[0] + v->rows[1] + v->rows[2];
  double *z = room, *radius = z + TOGETHER * v->nodes * space, *D = radius + TOGETHER * v->nodes;
  double *h = D + TOGETHER * (space * all + v->rows[3]);
  double extent[TOGETHER] = {0}, far[TOGETHER] = {0}, total[TOGETHER] = {0};
  for (int l = 0; l < TOGETHER; l++) {
    const int32_t *number = v->numbers + v->nodes * (cell + (l < count ? l : count - 1));
    for (int a = 0; a < v->nodes; a++)
      for (int i = 0; i < space; i++) z[(a * space + i) * TOGETHER + l] = x[number[a] + i];
  }
  for (int a = v->nodes - 1; a >= 0; a--)
    for (int i = 0; i < space; i++)
      for (int l = 0; l < TOGETHER; l++) {
        const double at = z[(a * space + i) * TOGETHER + l], away = at - z[i * TOGETHER + l];
        if (i == 0) radius[a * TOGETHER + l] = at;
        z[(a * space + i) * TOGETHER + l] = away;
        extent[l] = larger(extent[l], fabs(away)), far[l] = larger(far[l], fabs(at)), total[l] += at;
      }
  double g[4][TOGETHER] = {{0}}, e[4][TOGETHER];
  for (int i = 0; i < space; i++) {
    double *component = D + TOGETHER * i * all;
    map_nodes(v, 0, all, z + TOGETHER * i, TOGETHER * space, component);
    for (int k = 0, row = 0; k < dim; row += v->rows[k++])
      largest(component + TOGETHER * row, v->alone + row, v->rows[k], g[k]);
  }
  double *r = D + TOGETHER * space * all;
  map_nodes(v, all, v->rows[3], radius, TOGETHER, r);
  largest(r, v->alone + all, v->rows[3], g[3]);
  for (int k = 0; k < 4; k++)
    for (int l = 0; l < TOGETHER; l++)
      e[k][l] = DBL_EPSILON * (v->spread * (v->nodes * extent[l] + far[l]) + v->terms * g[k][l]);

  const long size = TOGETHER * (long)all, two = TOGETHER * v->rows[0], three = two + TOGETHER * v->rows[1];
  memset(n, 0, (size_t)(TOGETHER * v->outer) * sizeof *n);
  memset(h, 0, (size_t)(3 * TOGETHER * v->inner) * sizeof *h);
  for (int l = 0; l < TOGETHER; l++) {
    const double cross = e[0][l] * g[1][l] + e[1][l] * g[0][l], area = g[0][l] * g[1][l];
    margin[l] = v->kind == SURFACE    ? 24 * area * cross
                : v->kind == REVOLVED ? 2 * (g[3][l] * cross + e[3][l] * area)
                : dim == 3            ? 6 * (g[2][l] * cross + e[2][l] * area)
                                      : 2 * cross;
    if (!isfinite(total[l]) || !isfinite(margin[l])) margin[l] = INFINITY;
  }
  if (v->kind == SOLID && dim == 3) {
    for (int i = 0; i < 3; i++) {
      const long j = size * ((i + 1) % 3), k = size * ((i + 2) % 3);
      double *c = h + TOGETHER * i * v->inner;
      convolve(v->first, v->rows[1], v->rows[2], D + j + two, D + k + three, 1, c);
      convolve(v->first, v->rows[1], v->rows[2], D + k + two, D + j + three, -1, c);
      convolve(v->second, v->rows[0], v->inner, D + size * i, c, 1, n);
    }
  } else if (v->kind == SURFACE) {
    for (int i = 0; i < 3; i++) {
      const long j = size * ((i + 1) % 3), k = size * ((i + 2) % 3);
      double *c = h + TOGETHER * i * v->inner;
      convolve(v->first, v->rows[0], v->rows[1], D + j, D + k + two, 1, c);
      convolve(v->first, v->rows[0], v->rows[1], D + k, D + j + two, -1, c);
      convolve(v->second, v->inner, v->inner, c, c, 1, n);
    }
  } else {
    double *c = v->kind == REVOLVED ? h : n;
    convolve(v->first, v->rows[0], v->rows[1], D, D + size + two, 1, c);
    convolve(v->first, v->rows[0], v->rows[1], D + size, D + two, -1, c);
    if (v->kind == REVOLVED) convolve(v->second, v->rows[3], v->inner, r, h, 1, n);
  }
  for (int i = 0; i < v->outer; i++)
    for (int l = 0; l < TOGETHER; l++) n[i * TOGETHER + l] *= v->inverse[i];
}

/* Coefficients of n of all cells, (cells, outer), and their margins: with x at rest they are d. */
void validity_coefficients(const validity_t *v, const double *x, double *room, double *out, double *margins)
{
  double *n = room, *rest = n + TOGETHER * v->outer;
  for (long cell = 0; cell < v->cells; cell += TOGETHER) {
    const long count = v->cells - cell < TOGETHER ? v->cells - cell : TOGETHER;
    double margin[TOGETHER];
    coefficients(v, x, cell, count, rest, n, margin);
    for (long l = 0; l < count; l++) {
      margins[cell + l] = margin[l];
      for (int i = 0; i < v->outer; i++) out[v->outer * (cell + l) + i] = n[i * TOGETHER + l];
    }
  }
}

/* Least bound, least and largest value at a corner. A least bound that rounding may have made positive is 0.
   On the axis of a body of revolution n and d vanish together; J is bounded by what it is beside it, and tends
   to the quotient of the next coefficients along an edge that leaves it. */
static inline __attribute__((always_inline)) void bound(const validity_t *v, const int lanes, const double *c,
                                                        const double *d, const double *tiny, const double *margin,
                                                        double *low, double *high, double *most)
{
  const int varies = v->width > 1, axis = v->kind == REVOLVED;
  double least[TOGETHER];
  for (int l = 0; l < lanes; l++) {
    low[l] = least[l] = high[l] = INFINITY;
    most[l] = -INFINITY;
  }
  for (int i = 0; i < v->outer; i++)
    for (int l = 0; l < lanes; l++) {
      const double ci = c[i * lanes + l], di = d[varies * i * lanes + l];
      const double vanishes = axis && di >= 0 && ci >= -margin[l] ? INFINITY : -INFINITY;
      const double ratio = di > tiny[l] ? ci / di : vanishes, size = di > tiny[l] ? ci : INFINITY;
      low[l] = ratio < low[l] ? ratio : low[l];
      least[l] = size < least[l] ? size : least[l];
    }
  for (int k = 0; k < v->corners; k++)
    for (int edge = 0; edge <= (axis ? v->dim : 0); edge++)
      for (int l = 0; l < lanes; l++) {
        const int16_t *corner = v->corner + k * (v->dim + 1);
        const int i = corner[edge] * lanes + l, first = corner[0] * lanes + l;
        const double di = d[varies * corner[edge] * lanes + l], ratio = c[i] / di;
        const int known = di > tiny[l] &&
                          (!edge || (d[varies * first] <= tiny[l] && fabs(c[first]) <= margin[l]));
        high[l] = known && ratio < high[l] ? ratio : high[l];
        most[l] = known && ratio > most[l] ? ratio : most[l];
      }
  for (int l = 0; l < lanes; l++) {
    if (!(least[l] > margin[l]) && low[l] > 0) low[l] = 0;
    if (!isfinite(margin[l])) low[l] = -INFINITY, high[l] = INFINITY, most[l] = -INFINITY;
  }
}

static void middle(const validity_t *v, const double *vertex, double *where)
{
  for (int k = 0; k < v->dim; k++) {
    where[k] = 0;
    for (int p = 0; p < v->vertices; p++) where[k] += vertex[p * v->dim + k] / v->vertices;
  }
}

/* Largest number of d of a cell, and below what none of them is told from 0. */
static double scale(const validity_t *v, long cell, double *tiny)
{
  double size = 0;
  for (int i = 0; i < v->width; i++) size = larger(size, v->d[v->width * cell + i]);
  *tiny = v->width > 1 ? 1e-13 * size : 0;
  return size;
}

/* First look: bounds of all cells, squared on a surface, and the middle of each. room as of
   coefficients(), and 2 TOGETHER outer numbers. */
void validity_scan(const validity_t *v, const double *x, double *room, double *low, double *high, double *most,
                   double *where)
{
  double *n = room, *d = n + TOGETHER * v->outer, *rest = d + TOGETHER * v->outer;
  for (long cell = 0; cell < v->cells; cell += TOGETHER) {
    const long count = v->cells - cell < TOGETHER ? v->cells - cell : TOGETHER;
    double margin[TOGETHER], tiny[TOGETHER], side[TOGETHER], bounds[3][TOGETHER];
    coefficients(v, x, cell, count, rest, n, margin);
    for (long l = 0; l < TOGETHER; l++) {
      const long own = cell + (l < count ? l : count - 1);
      for (int i = 0; i < v->width; i++) d[i * TOGETHER + l] = v->d[v->width * own + i];
      scale(v, own, &tiny[l]);
      side[l] = v->side[own];
    }
    for (int i = 0; i < v->outer; i++)
      for (int l = 0; l < TOGETHER; l++) n[i * TOGETHER + l] *= side[l];
    bound(v, TOGETHER, n, d, tiny, margin, bounds[0], bounds[1], bounds[2]);
    for (long l = 0; l < count; l++) {
      low[cell + l] = bounds[0][l], high[cell + l] = bounds[1][l], most[cell + l] = bounds[2][l];
      middle(v, v->vertex, where + v->dim * (cell + l));
    }
  }
}

/* Whether bounds decide the sign and are narrow; range: of values known in the cell. */
static int settled(const validity_t *v, double low, double best, double high, double most)
{
  if (!(low > 0) && best > 0) return 0;
  if (low >= best) return 1;
  double range = most - high;
  if (v->kind == SURFACE) {
    low = sqrt(larger(low, 0)), best = sqrt(larger(best, 0));
    range = sqrt(larger(most, 0)) - sqrt(larger(high, 0));
  }
  const double size = low > 0 ? low : -best;
  return best - low <= NARROW * larger(size, range);
}

/* Squared length of the edge that a simplex is halved along; of a cube 1, as none of its ways is oblique. */
static double edge_length(const validity_t *v, const double *vertex, int direction)
{
  const int16_t *end = v->ends + 4 * direction;
  double sum = 0;
  if (v->vertices <= v->dim) return 1;
  for (int k = 0; k < v->dim; k++) {
    const double side = vertex[end[0] * v->dim + k] - vertex[end[1] * v->dim + k];
    sum += side * side;
  }
  return sum;
}

/* Direction in which what makes the least coefficient lie below the polynomial is largest: the second
   difference along its lines, of n - best d over d. Edges of less than 0.7 of the longest are not halved: in
   thin simplices what varies along one edge is seen along the others, too. */
static int steepest(const validity_t *v, const double *part, double tiny, double best)
{
  const double *c = part, *d = part + v->outer, *vertex = d + (v->width > 1 ? v->outer : 0);
  const int varies = v->width > 1 && isfinite(best);
  double longest = 0, length[MAX_DIRECTIONS], most = 0;
  int chosen = 0;
  for (int q = 0; q < v->directions; q++) {
    length[q] = edge_length(v, vertex, q);
    if (length[q] > longest) longest = length[q], chosen = q;
  }
  for (int q = 0; q < v->directions; q++)
    for (int32_t k = v->begin[q]; k < v->begin[q + 1] && length[q] >= longest / 2; k += v->lines[k] + 1) {
      const int16_t *i = v->lines + k + 1;
      for (int j = 2; j < v->lines[k]; j++) {
        double bend = c[i[j]] - 2 * c[i[j - 1]] + c[i[j - 2]];
        if (varies) {
          bend -= best * (d[i[j]] - 2 * d[i[j - 1]] + d[i[j - 2]]);
          bend /= larger(larger(d[i[j]], d[i[j - 2]]), larger(d[i[j - 1]], tiny));
        }
        if (bend > most) most = bend, chosen = q;
      }
    }
  return chosen;
}

/* Coefficients of both halves; left may be c itself. */
static void halve(const validity_t *v, int direction, const double *c, double *left, double *right)
{
  for (int32_t k = v->begin[direction]; k < v->begin[direction + 1]; k += v->lines[k] + 1) {
    const int16_t *i = v->lines + k + 1;
    const int last = v->lines[k] - 1;
    double w[MAX_LINE];
    for (int j = 0; j <= last; j++) w[j] = c[i[j]];
    for (int step = 0; step <= last; step++) {
      left[i[step]] = w[0];
      right[i[last - step]] = w[last - step];
      for (int j = 0; j < last - step; j++) w[j] = (w[j] + w[j + 1]) / 2;
    }
  }
}

static void halve_vertices(const validity_t *v, int direction, double *left, double *right)
{
  const int16_t *end = v->ends + 4 * direction;
  memcpy(right, left, (size_t)(v->vertices * v->dim) * sizeof *left);
  for (int k = end[2]; k < end[3]; k++) {
    const double half = (left[end[0] * v->dim + k] + left[end[1] * v->dim + k]) / 2;
    left[end[1] * v->dim + k] = right[end[0] * v->dim + k] = half;
  }
}

/* Numbers of one part: coefficients of n, of d where it varies, vertices. */
static long part_size(const validity_t *v)
{
  return v->outer + (v->width > 1 ? v->outer : 0) + v->vertices * v->dim;
}

/* Second look: halve the cells whose bounds are wider than they should be, at a best value known of all
   cells. room as of validity_scan(), parts: MAX_PARTS times part_size(). The number of cells halved. */
long validity_refine(const validity_t *v, const double *x, double best, double *room, double *parts, double *low,
                     double *high, double *most, double *where)
{
  const long size = part_size(v), corner = size - v->vertices * v->dim;
  long halved = 0;
  for (long cell = 0; cell < v->cells; cell++) {
    if (settled(v, low[cell], best, high[cell], most[cell])) continue;
    double margin[TOGETHER], lows[MAX_PARTS], tiny;
    int depth[MAX_PARTS] = {0}, count = 1, least = 0;
    coefficients(v, x, cell, 1, room + TOGETHER * v->outer, room, margin);
    if (!isfinite(margin[0])) continue;
    halved++;
    for (int i = 0; i < v->outer; i++) parts[i] = v->side[cell] * room[i * TOGETHER];
    if (v->width > 1) memcpy(parts + v->outer, v->d + (long)v->width * cell, (size_t)v->width * sizeof *parts);
    memcpy(parts + corner, v->vertex, (size_t)(v->vertices * v->dim) * sizeof *parts);
    const double exact = 4 * margin[0] / scale(v, cell, &tiny);
    lows[0] = low[cell];
    for (;;) {
      const double known = best < high[cell] ? best : high[cell];
      for (int k = least = 0; k < count; k++)
        if (lows[k] < lows[least]) least = k;
      if (count == MAX_PARTS || known - lows[least] <= exact ||
          settled(v, lows[least], known, high[cell], most[cell]))
        break;
      double *part = parts + size * least, *other = parts + size * count;
      const double value = isfinite(lows[least]) ? known : INFINITY;
      const int direction = steepest(v, part, tiny, value);
      halve(v, direction, part, part, other);
      if (v->width > 1) halve(v, direction, part + v->outer, part + v->outer, other + v->outer);
      halve_vertices(v, direction, part + corner, other + corner);
      depth[count] = ++depth[least];
      const int pair[2] = {least, count++};
      for (int k = 0; k < 2; k++) {
        double *own = parts + size * pair[k], found[3];
        const double *d = v->width > 1 ? own + v->outer : v->d + cell;
        const double rounded = margin[0] * (1 + depth[least]);
        bound(v, 1, own, d, &tiny, &rounded, &found[0], &found[1], &found[2]);
        lows[pair[k]] = found[0];
        most[cell] = larger(most[cell], found[2]);
        if (found[1] < high[cell]) {
          high[cell] = found[1];
          middle(v, own + corner, where + v->dim * cell);
        }
      }
    }
    low[cell] = lows[least];
  }
  return halved;
}

#endif
