/* Elementary functions and random bits that the compiler can vectorise.
 *
 * Plain polynomials after a range reduction, no tables, no branches, no integer conversions: each function is
 * inlined into a `#pragma omp simd` loop and becomes straight-line vector code on any instruction set.
 * Absolute errors (see `math_probe`): sine and cosine 1e-14 + 1e-16 |x|, angle 3e-14.
 */
#ifndef VECTOR_MATH_H
#define VECTOR_MATH_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#define PI 3.141592653589793116
#define INLINE static inline __attribute__((always_inline))

INLINE double bits_to_double(uint64_t bits) {
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

INLINE uint64_t double_to_bits(double value) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* sin(x) and cos(x). Polynomials for half the reduced angle, then one doubling: this removes the parity of
 * the multiple of pi, and with it all integer work. Fused multiply-adds keep the reduction exact to 1e-16
 * |x|. */
INLINE void sine_cosine(double x, double *sine, double *cosine) {
    double h = 0.5 * x - PI * rint(x * (0.5 / PI));
    double q = h * h;
    double s = -7.3743875038627574e-13;
    s = s * q + 1.6048168318165642e-10;
    s = s * q - 2.5051881946712588e-8;
    s = s * q + 2.7557316609073674e-6;
    s = s * q - 1.9841269824861896e-4;
    s = s * q + 8.3333333332827555e-3;
    s = s * q - 1.6666666666666073e-1;
    s = h + h * (q * s);
    double c = 4.608977003001797e-14;
    c = c * q - 1.1462901901757275e-11;
    c = c * q + 2.0876561839933163e-9;
    c = c * q - 2.7557316391025751e-7;
    c = c * q + 2.4801587277414924e-5;
    c = c * q - 1.388888888877299e-3;
    c = c * q + 4.1666666666663882e-2;
    c = c * q - 4.9999999999999974e-1;
    c = c * q + 1.0;
    *sine = 2.0 * s * c;
    *cosine = 1.0 - 2.0 * s * s;
}

/* Angle in [0, 2 pi) of the vector (dot, cross) whose length is `length` (known beforehand, so no square
 * root). tan(angle / 2) = |cross| / (length + |dot|) lies in [0, 1]; turning by pi/8 halves the range of
 * the polynomial. In two parts, so that the division and the polynomial can stand in different loops. */
INLINE double angle_ratio(double cross, double dot, double length) {
    const double tan_pi_8 = 0.414213562373095049;
    double y = fabs(cross), x = length + fabs(dot) + 1e-300;
    return (y - tan_pi_8 * x) / (x + tan_pi_8 * y);
}

INLINE double angle_from_ratio(double ratio, double cross, double dot) {
    double q = ratio * ratio;
    double p = 3.0662440370424449e-2;
    p = p * q - 5.8745056213078307e-2;
    p = p * q + 7.563703551915192e-2;
    p = p * q - 9.0783920729434234e-2;
    p = p * q + 1.1110385046148014e-1;
    p = p * q - 1.4285690423839287e-1;
    p = p * q + 1.9999999604891978e-1;
    p = p * q - 3.3333333330803446e-1;
    p = p * q + 9.9999999999997323e-1;
    double quadrant = 0.25 * PI + 2.0 * (ratio * p);
    double half_plane = dot < 0.0 ? PI - quadrant : quadrant;
    return cross < 0.0 ? 2.0 * PI - half_plane : half_plane;
}

/* One output of xoroshiro128+ (Blackman and Vigna); both state words are updated. */
INLINE uint64_t random_bits(uint64_t *first, uint64_t *second) {
    uint64_t a = *first, b = *second, sum = a + b;
    b ^= a;
    *first = ((a << 24) | (a >> 40)) ^ b ^ (b << 16);
    *second = (b << 37) | (b >> 27);
    return sum;
}

/* Standard exponential, -log(uniform), from 52 random bits. The logarithm is right to 4e-12, far below what
 * any sample could show; it shapes only the law of the gaps, never the motion for a given gap. */
INLINE double exponential(uint64_t bits) {
    double uniform = 2.0 - bits_to_double((bits >> 12) | 0x3ff0000000000000u); /* in (0, 1] */
    uint64_t pattern = double_to_bits(uniform);
    double exponent = bits_to_double((pattern >> 52) | 0x4330000000000000u) - (4503599627370496.0 + 1023.0);
    double t = bits_to_double((pattern & 0x000fffffffffffffu) | 0x3ff0000000000000u) - 1.5;
    double p = 5.6162325836986177e-4;
    p = p * t - 9.0915902877899339e-4;
    p = p * t + 9.8976993950251219e-4;
    p = p * t - 1.6359844549576941e-3;
    p = p * t + 2.9010377537515809e-3;
    p = p * t - 4.8945881134294314e-3;
    p = p * t + 8.3601341039088691e-3;
    p = p * t - 1.4630376291420732e-2;
    p = p * t + 2.6337489001618397e-2;
    p = p * t - 4.9382780856224748e-2;
    p = p * t + 9.876543146358777e-2;
    p = p * t - 2.2222222120441248e-1;
    p = p * t + 6.6666666666828865e-1;
    p = p * t + 4.0546510810556534e-1;
    return fmax(-(p + exponent * 0.69314718055994530942), 0.0);
}

/* Seeds generators: successive outputs of splitmix64 (Steele, Lea and Flood). */
INLINE uint64_t splitmix(uint64_t *state) {
    uint64_t x = (*state += 0x9e3779b97f4a7c15u);
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

#endif
