/* Mass and spring on a base of velocity +w or -w: two vectorised programs for the exact stick-slip motion.
 *
 * Dimensionless: z (position over stick half-width), u (velocity), time omega t, w > 0. The state is kept in
 * the frame in which the base moves with +w: when the base switches, (z, u) becomes (-z, -u). There
 *   slip below (u < w) is a clockwise circle about (+1, 0), slip above (u > w) one about (-1, 0);
 *   a stick is u = w and |z| <= 1: z grows with w until z = 1, then the mass follows the circle of radius w
 *   about (+1, 0), which only touches u = w: no second stick before the next switch.
 *
 * PROGRAM_EVENTS: a step takes each lane to its next event (switch, arrival at u = w, release, horizon).
 *
 * PROGRAM_INTERVALS: a step takes each lane through a whole base interval in closed form: at most one
 * arrival, one stick, one release, one rotation. A pass through u = w with |z| > 1 ends the step early, and
 * the lane goes on with what is left of its gap in the next step: any number of passes is right.
 *
 * LANES trajectories advance in lock step, in struct-of-arrays form inside the first-level cache. A lane
 * whose trajectory has reached the horizon begins its next one at once, up to its quota: lanes rarely idle.
 */
#include "vector_math.h"

#ifndef LANES
#define LANES 64
#endif
#define PROGRAM_EVENTS 0
#define PROGRAM_INTERVALS 1
#define HUGE_SLOPE 1e200 /* makes a condition of a difference: min(HUGE_SLOPE * x, 1) is 0 or 1 */
#define NEVER 1e30 /* time left of an idle lane: it goes on moving, and never reaches a horizon */

/* Aligned as a whole: an aligned array type would keep the compiler from vectorising its elements. */
typedef double lanes_t[LANES];
typedef struct __attribute__((aligned(64))) {
    lanes_t z, u;       /* state in the frame of the base */
    lanes_t gap;        /* time to the next switch; 0 asks for a new gap */
    lanes_t left;       /* time to the horizon */
    lanes_t mode;       /* SLIP, RELEASED or STUCK; used by PROGRAM_EVENTS only */
    lanes_t sticks, stick_time, intervals; /* of the present trajectory */
    uint64_t first[LANES], second[LANES]; /* generator state of each lane */
    int64_t quota[LANES]; /* trajectories still to begin */
} block_t;

#define SLIP 0.0
#define RELEASED 1.0
#define STUCK 2.0

/* Scratch of one step. */
typedef struct __attribute__((aligned(64))) {
    lanes_t centre; /* +-1, of the arc on which the lane starts the step */
    lanes_t q;      /* distance of the arrival at u = w from the line z = centre; 0 if it is never reached */
    lanes_t time;   /* to that arrival; NEVER if it is never reached */
    lanes_t cross, dot, ratio;
    lanes_t pivot, d, v, turn; /* the rotation that ends the step: of (d, v) about pivot */
    lanes_t mirror; /* -1 where the base switches */
} scratch_t;

/* Where and when the arc from (z, u) arrives at u = w. The work of a step is spread over several short
 * loops: the processor then has many independent lanes at hand in each, which one long loop would keep out
 * of its reach. No conditions on conditions: gcc would not turn them into vector code. */
INLINE void find_arrivals(block_t *restrict b, scratch_t *restrict s, double w, const int random,
                          double mean_gap) {
#pragma omp simd
    for (int i = 0; i < LANES; i++) {
        if (random) {
            double fresh = mean_gap * exponential(random_bits(&b->first[i], &b->second[i]));
            b->gap[i] = b->gap[i] > 0.0 ? b->gap[i] : fresh;
        }
        double z = b->z[i], u = b->u[i];
        /* Exactly on u = w the mass goes above if it is below the band (z < -1), else below, or it sticks. */
        double centre = copysign(1.0, u == w ? z + 1.0 : w - u);
        double d = z - centre;
        double q = sqrt(fmax(d * d + (u - w) * (u + w), 0.0)); /* exactly |d| on u = w */
        double offset = -centre * q;
        double cross = u * offset - d * w, dot = d * offset + u * w;
        s->centre[i] = centre;
        s->q[i] = q;
        s->cross[i] = cross;
        s->dot[i] = dot;
        s->ratio[i] = angle_ratio(cross, dot, d * d + u * u);
    }
#pragma omp simd
    for (int i = 0; i < LANES; i++) {
        double angle = angle_from_ratio(s->ratio[i], s->cross[i], s->dot[i]);
        /* A start on u = w inside the band has arrived already: there the angle is 0 or 2 pi by round-off. */
        double away = fmax(HUGE_SLOPE * fabs(b->u[i] - w), fabs(b->z[i]) - 1.0);
        double time = away > 0.0 ? angle : 0.0;
        s->time[i] = s->q[i] > 0.0 ? time : NEVER;
    }
}

/* The rotation that ends a step, clockwise, in the frame of the base after the step. */
static void rotate(block_t *restrict b, const scratch_t *restrict s) {
#pragma omp simd
    for (int i = 0; i < LANES; i++) {
        double sine, cosine;
        sine_cosine(s->turn[i], &sine, &cosine);
        b->z[i] = s->mirror[i] * (s->pivot[i] + s->d[i] * cosine + s->v[i] * sine);
        b->u[i] = s->mirror[i] * (s->v[i] * cosine - s->d[i] * sine);
    }
}

/* PROGRAM_INTERVALS: one base interval of each lane. Returns the smallest time left of all lanes. */
INLINE double step_intervals(block_t *restrict b, scratch_t *restrict s, double w, const int random,
                             double mean_gap) {
    const double inv_w = 1.0 / w;
    double least = NEVER;
    find_arrivals(b, s, w, random, mean_gap);
#pragma omp simd reduction(min : least)
    for (int i = 0; i < LANES; i++) {
        double z = b->z[i], u = b->u[i], gap = b->gap[i], left = b->left[i];
        double centre = s->centre[i], q = s->q[i], time = s->time[i];
        double landing = centre - centre * q;
        double cut = fmin(gap, left);
        double after = cut - time; /* time left at the arrival; negative: none in this interval */
        double passing = q > 2.0 ? time : NEVER;
        double room = q > 2.0 ? 0.0 : (1.0 - landing) * inv_w;
        double stay = fmax(fmin(room, after), 0.0);
        double whole = passing < cut ? 0.0 : 1.0; /* the interval has ended: the base switches */
        /* Last rotation: from the end of the stick, from the crossing (by nothing), or the whole arc. */
        double turn = after > 0.0 ? whole * (after - stay) : cut;
        double pivot = after > 0.0 ? 1.0 : centre;
        double place = after > 0.0 ? landing + w * stay : z;
        s->turn[i] = turn;
        s->pivot[i] = pivot;
        s->d[i] = place - pivot;
        s->v[i] = after > 0.0 ? w : u;
        s->mirror[i] = 1.0 - 2.0 * whole;
        double used = fmin(passing, cut);
        b->gap[i] = (1.0 - whole) * (gap - used);
        left -= used;
        b->left[i] = left;
        least = fmin(least, left);
        /* 1 if stay > 0. A conditional sum would become a branch in gcc. */
        b->sticks[i] += fmin(HUGE_SLOPE * stay, 1.0);
        b->stick_time[i] += stay;
        b->intervals[i] += whole;
    }
    rotate(b, s);
    return least;
}

/* PROGRAM_EVENTS: each lane moves to its next event. Returns the smallest time left of all lanes. */
INLINE double step_events(block_t *restrict b, scratch_t *restrict s, double w, const int random,
                          double mean_gap) {
    const double inv_w = 1.0 / w;
    double least = NEVER;
    find_arrivals(b, s, w, random, mean_gap);
#pragma omp simd reduction(min : least)
    for (int i = 0; i < LANES; i++) {
        double z = b->z[i], u = b->u[i], gap = b->gap[i], left = b->left[i], mode = b->mode[i];
        double centre = s->centre[i], q = s->q[i];
        double landing = centre - centre * q;
        double limit = fmin(gap, left);
        double slip_end = mode > 0.5 ? NEVER : s->time[i]; /* none after a release */
        double stuck = mode > 1.5 ? 1.0 : 0.0;
        double next = mode > 1.5 ? (1.0 - z) * inv_w : slip_end;
        double dt = fmin(next, limit);
        double switches = next < limit ? 0.0 : 1.0; /* or the horizon is reached */
        double z_slip = next < limit ? landing : z;
        double u_slip = next < limit ? w : u;
        s->pivot[i] = centre;
        s->d[i] = (mode > 1.5 ? z + w * dt : z_slip) - centre;
        s->v[i] = mode > 1.5 ? w : u_slip;
        s->turn[i] = (1.0 - stuck) * switches * dt;
        s->mirror[i] = 1.0 - 2.0 * switches;
        /* 1 if an arrival here begins a stick of positive length. */
        double begins = q > 2.0 ? 0.0 : fmin(HUGE_SLOPE * (1.0 - landing), 1.0);
        double mode_after = mode > 1.5 ? RELEASED : STUCK * begins;
        b->mode[i] = (1.0 - switches) * mode_after;
        b->sticks[i] += (1.0 - switches) * (1.0 - stuck) * begins;
        b->stick_time[i] += stuck * dt;
        b->intervals[i] += switches;
        b->gap[i] = (1.0 - switches) * (gap - dt);
        left -= dt;
        b->left[i] = left;
        least = fmin(least, left);
    }
    rotate(b, s);
    return least;
}

INLINE double step(block_t *b, scratch_t *s, int program, double w, const int random, double mean_gap) {
    return program == PROGRAM_EVENTS ? step_events(b, s, w, random, mean_gap)
                                     : step_intervals(b, s, w, random, mean_gap);
}

/* Puts a lane at the start of a trajectory, in the frame of the base; `sign` is the first sign of the
 * velocity. */
static void begin(block_t *b, int i, double z0, double u0, double sign, double horizon) {
    b->z[i] = sign * z0;
    b->u[i] = sign * u0;
    b->left[i] = horizon;
    b->gap[i] = 0.0;
    b->mode[i] = SLIP;
    b->sticks[i] = b->stick_time[i] = b->intervals[i] = 0.0;
}

typedef struct {
    int64_t samples;
    double intervals, sticks, stick_time, sticks_squared, stick_time_squared;
} totals_t;

typedef struct {
    double w, mean_gap, horizon, z0, u0;
    int sign; /* +1 or -1: first sign of the base velocity; 0: fair coin */
} case_t;

static void begin_random(block_t *b, int i, const case_t *c) {
    if (b->quota[i] <= 0) {
        begin(b, i, 0.0, 0.0, 1.0, NEVER);
        return;
    }
    b->quota[i]--;
    double sign = c->sign;
    if (c->sign == 0) sign = (random_bits(&b->first[i], &b->second[i]) >> 63) ? 1.0 : -1.0;
    begin(b, i, c->z0, c->u0, sign, c->horizon);
}

/* Books the trajectories that have ended and starts the next ones. Returns how many ended. */
static int64_t harvest(block_t *b, const case_t *c, totals_t *totals) {
    int64_t ended = 0;
    for (int i = 0; i < LANES; i++) {
        if (b->left[i] > 0.0) continue;
        ended++;
        totals->intervals += b->intervals[i];
        totals->sticks += b->sticks[i];
        totals->stick_time += b->stick_time[i];
        totals->sticks_squared += b->sticks[i] * b->sticks[i];
        totals->stick_time_squared += b->stick_time[i] * b->stick_time[i];
        begin_random(b, i, c);
    }
    totals->samples += ended;
    return ended;
}

/* `samples` random trajectories in blocks of LANES lanes, each lane running up to `chain` of them one after
 * the other (0: as many as there are). With chain = 1 a block lasts until its slowest lane has ended. */
void bangbang_run(int program, const case_t *c, uint64_t seed, int64_t samples, int64_t chain,
                  totals_t *totals) {
    block_t block;
    scratch_t scratch;
    memset(totals, 0, sizeof *totals);
    memset(&block, 0, sizeof block);
    for (int i = 0; i < LANES; i++) {
        block.first[i] = splitmix(&seed);
        block.second[i] = splitmix(&seed);
    }
    while (samples > 0) {
        int64_t take = chain > 0 && chain * LANES < samples ? chain * LANES : samples;
        for (int i = 0; i < LANES; i++) {
            block.quota[i] = take / LANES + (i < take % LANES);
            begin_random(&block, i, c);
        }
        int64_t running = take;
        while (running > 0)
            if (step(&block, &scratch, program, c->w, 1, c->mean_gap) <= 0.0)
                running -= harvest(&block, c, totals);
        samples -= take;
    }
}

typedef struct {
    const double *z0, *u0, *sign; /* per trajectory; sign of the first velocity */
    const double *gaps;           /* trajectories x n_gaps, row by row */
    double *intervals, *sticks, *stick_time, *z, *u;
} given_t;

/* Next given gap of each lane that asks for one; after the last switch the base keeps its velocity. */
static void read_gaps(block_t *b, const given_t *g, int64_t base, int64_t n_gaps, int64_t *position) {
    for (int i = 0; i < LANES; i++) {
        if (b->gap[i] > 0.0) continue;
        int64_t k = position[i]++;
        b->gap[i] = !b->quota[i] ? 1.0 : k < n_gaps ? g->gaps[(base + i) * n_gaps + k] : NEVER;
    }
}

/* The same step functions on given gaps: one lane per trajectory, results per trajectory, in the fixed
 * frame. */
void bangbang_given(int program, double w, double horizon, int64_t count, int64_t n_gaps, const given_t *g) {
    block_t b;
    scratch_t scratch;
    memset(&b, 0, sizeof b);
    for (int64_t base = 0; base < count; base += LANES) {
        int64_t running = count - base < LANES ? count - base : LANES, position[LANES] = {0};
        for (int i = 0; i < LANES; i++) {
            b.quota[i] = i < running;
            if (i < running) begin(&b, i, g->z0[base + i], g->u0[base + i], g->sign[base + i], horizon);
            else begin(&b, i, 0.0, 0.0, 1.0, NEVER);
        }
        while (running > 0) {
            read_gaps(&b, g, base, n_gaps, position);
            if (step(&b, &scratch, program, w, 0, 0.0) > 0.0) continue;
            for (int i = 0; i < LANES; i++) {
                if (b.left[i] > 0.0) continue;
                int64_t j = base + i;
                double back = g->sign[j] * (fmod(b.intervals[i], 2.0) == 0.0 ? 1.0 : -1.0);
                g->intervals[j] = b.intervals[i];
                g->sticks[j] = b.sticks[i];
                g->stick_time[j] = b.stick_time[i];
                g->z[j] = back * b.z[i];
                g->u[j] = back * b.u[i];
                b.quota[i] = 0;
                begin(&b, i, 0.0, 0.0, 1.0, NEVER);
                running--;
            }
        }
    }
}

/* For tests: sin, cos of x and the angle of (dot, cross) = (cos x, sin x) in [0, 2 pi). */
void math_probe(int64_t n, const double *x, double *sine, double *cosine, double *angle) {
    for (int64_t i = 0; i < n; i++) {
        sine_cosine(x[i], &sine[i], &cosine[i]);
        double cross = sin(x[i]), dot = cos(x[i]);
        angle[i] = angle_from_ratio(angle_ratio(cross, dot, 1.0), cross, dot);
    }
}
