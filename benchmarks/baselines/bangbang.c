/* Mass and spring on a base of velocity +w or -w: two vectorised programs for the exact stick-slip motion.
 *
 * Dimensionless: z (position over stick half-width), u (velocity), time omega t, w > 0. The state is kept in the
 * frame in which the base moves with +w: when the base switches, (z, u) becomes (-z, -u). In that frame
 *   slip below (u < w): clockwise circle about (+1, 0);  slip above (u > w): clockwise circle about (-1, 0);
 *   stick: u = w and |z| <= 1, z grows with w until z = 1, then the circle of radius w about (+1, 0) is followed,
 *   which only touches u = w: no second stick before the next switch.
 *
 *   PROGRAM_EVENTS    a step takes each lane to its next event: switch, arrival at u = w, release or horizon.
 *   PROGRAM_INTERVALS a step takes each lane through a whole base interval in closed form: at most one arrival,
 *                     one stick, one release, one rotation. A pass through u = w with |z| > 1 ends the step early and
 *                     the lane goes on with what is left of its gap in the next step, so any number is right.
 *
 * LANES trajectories advance in lock step, in struct-of-arrays form inside the first-level cache. A lane whose
 * trajectory has reached the horizon begins its next one at once, up to its quota, so lanes rarely idle.
 */
#include "vector_math.h"

#ifndef LANES
#define LANES 64
#endif
#define PROGRAM_EVENTS 0
#define PROGRAM_INTERVALS 1
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

/* The arc from (z, u): its centre +-1, the distance q of the arrival at u = w from the line through the centre, the
 * landing place z of the arrival, and the time to get there (NEVER if the arc does not reach u = w).
 * Written without conditions on conditions, which gcc would not turn into vector code. */
typedef struct {
    double centre, q, landing, time;
} arc_t;

INLINE arc_t arc_from(double z, double u, double w) {
    arc_t arc;
    /* Exactly on u = w the sign of u' = centre - z decides, that is the side of the band on which z lies. */
    arc.centre = copysign(1.0, (w - u) + 1e-300 * z);
    double d = z - arc.centre;
    double excess = d * d + (u * u - w * w);
    arc.q = sqrt(fmax(excess, 0.0));
    double offset = -arc.centre * arc.q;
    arc.landing = arc.centre + offset;
    double angle = angle_of(u * offset - d * w, d * offset + u * w, d * d + u * u);
    /* A start on u = w inside the band has arrived already: there the angle is 0 or 2 pi by round-off. */
    double away = fmax(1e300 * fabs(u - w), fabs(z) - 1.0);
    double time = away > 0.0 ? angle : 0.0;
    arc.time = excess > 0.0 ? time : NEVER;
    return arc;
}

static void draw_gaps(block_t *restrict b, double mean_gap) {
#pragma omp simd
    for (int i = 0; i < LANES; i++) {
        double fresh = mean_gap * exponential(random_bits(&b->first[i], &b->second[i]));
        b->gap[i] = b->gap[i] > 0.0 ? b->gap[i] : fresh;
    }
}

/* PROGRAM_INTERVALS: one base interval of each lane. Returns the smallest time left of all lanes. */
static double step_intervals(block_t *restrict b, double w) {
    const double inv_w = 1.0 / w;
    double least = NEVER;
#pragma omp simd reduction(min : least)
    for (int i = 0; i < LANES; i++) {
        double z = b->z[i], u = b->u[i], gap = b->gap[i], left = b->left[i];
        double cut = fmin(gap, left);
        arc_t arc = arc_from(z, u, w);
        double after = cut - arc.time; /* time left at the arrival; negative: none in this interval */
        double passing = arc.q > 2.0 ? arc.time : NEVER;
        double room = arc.q > 2.0 ? 0.0 : (1.0 - arc.landing) * inv_w;
        double stay = fmax(fmin(room, after), 0.0);
        /* Last rotation: from the end of the stick, from the crossing (by nothing), or the whole arc. */
        double rest = passing < cut ? 0.0 : after - stay;
        double turn = after > 0.0 ? rest : cut;
        double centre = after > 0.0 ? 1.0 : arc.centre;
        double place = after > 0.0 ? arc.landing + stay : z;
        double v = after > 0.0 ? w : u;
        double d = place - centre, s, c;
        sine_cosine(turn, &s, &c);
        double used = fmin(passing, cut);
        double mirror = passing < cut ? 1.0 : -1.0;
        b->z[i] = mirror * (centre + d * c + v * s);
        b->u[i] = mirror * (v * c - d * s);
        b->gap[i] = passing < cut ? gap - used : 0.0;
        left -= used;
        b->left[i] = left;
        least = fmin(least, left);
        b->sticks[i] += stay > 0.0 ? 1.0 : 0.0;
        b->stick_time[i] += stay;
        b->intervals[i] += passing < cut ? 0.0 : 1.0;
    }
    return least;
}

/* PROGRAM_EVENTS: each lane moves to its next event. Returns the smallest time left of all lanes. */
static double step_events(block_t *restrict b, double w) {
    const double inv_w = 1.0 / w;
    double least = NEVER;
#pragma omp simd reduction(min : least)
    for (int i = 0; i < LANES; i++) {
        double z = b->z[i], u = b->u[i], gap = b->gap[i], left = b->left[i], mode = b->mode[i];
        double limit = fmin(gap, left);
        arc_t arc = arc_from(z, u, w);
        double slip_end = mode > 0.5 ? NEVER : arc.time; /* none after a release */
        double next = mode > 1.5 ? (1.0 - z) * inv_w : slip_end;
        double dt = fmin(next, limit);
        double d = z - arc.centre, s, c;
        sine_cosine(dt, &s, &c);
        double z_turned = arc.centre + d * c + u * s, u_turned = u * c - d * s;
        double z_slip = next < limit ? arc.landing : z_turned;
        double u_slip = next < limit ? w : u_turned;
        double mirror = next < limit ? 1.0 : -1.0;
        b->z[i] = mirror * (mode > 1.5 ? z + w * dt : z_slip);
        b->u[i] = mirror * (mode > 1.5 ? w : u_slip);
        double room = arc.q > 2.0 ? 0.0 : 1.0 - arc.landing; /* length of a stick that begins at this arrival */
        double begins = room > 0.0 ? 1.0 : 0.0;
        double enters = mode > 1.5 ? 0.0 : begins;
        double mode_after = mode > 1.5 ? RELEASED : STUCK * begins;
        b->mode[i] = next < limit ? mode_after : SLIP;
        b->gap[i] = next < limit ? gap - dt : 0.0;
        left -= dt;
        b->left[i] = left;
        least = fmin(least, left);
        b->sticks[i] += next < limit ? enters : 0.0;
        b->stick_time[i] += mode > 1.5 ? dt : 0.0;
        b->intervals[i] += next < limit ? 0.0 : 1.0;
    }
    return least;
}

INLINE double step(block_t *b, int program, double w) {
    return program == PROGRAM_EVENTS ? step_events(b, w) : step_intervals(b, w);
}

/* Puts a lane at the start of a trajectory, in the frame of the base; `sign` is the first sign of the velocity. */
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

/* `samples` random trajectories in blocks of LANES lanes, each lane running up to `chain` of them one after the
 * other (0: as many as there are). With chain = 1 a block lasts until its slowest lane has ended. */
void bangbang_run(int program, const case_t *c, uint64_t seed, int64_t samples, int64_t chain, totals_t *totals) {
    block_t block;
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
        while (running > 0) {
            draw_gaps(&block, c->mean_gap);
            if (step(&block, program, c->w) <= 0.0) running -= harvest(&block, c, totals);
        }
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
        b->gap[i] = b->quota[i] && k < n_gaps ? g->gaps[(base + i) * n_gaps + k] : (b->quota[i] ? NEVER : 1.0);
    }
}

/* The same step functions on given gaps: one lane per trajectory, results per trajectory, in the fixed frame. */
void bangbang_given(int program, double w, double horizon, int64_t count, int64_t n_gaps, const given_t *g) {
    block_t b;
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
            if (step(&b, program, w) > 0.0) continue;
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
        angle[i] = angle_of(sin(x[i]), cos(x[i]), 1.0);
    }
}
