/*
 * Decimal text to the nearest double. Up to 19 significant digits fit 64 bits;
 * with a power of ten that is exact too, one correctly rounded operation gives
 * the answer (Clinger 1990). The rest goes through strtod, in a spelling
 * without a decimal point, which no locale changes.
 */
#include "proto/number.h"

#include <endian.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define DIGITS_IN_64_BITS 19
/* No double, nor the middle between two, has more significant digits. */
#define DIGITS_THAT_COUNT 770
/* Beyond these a number of that many digits is 0 or infinite. */
#define EXPONENT_CAP 10000L
/* A written exponent counts up to here: more digits than any text has. */
#define EXPONENT_READ_MAX 1000000000000000

/* 10^22 is the last power of ten that a double holds exactly. */
#define POWER_IN_DOUBLE 22
/* 5^27 is the last power of five under 2^64. */
#define POWER_IN_64_BITS 27

static const double tens[POWER_IN_DOUBLE + 1] = {
	1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11,
	1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
};

static const double signs[] = {1.0, -1.0};

static const uint64_t fives[POWER_IN_64_BITS + 1] = {
	1u, 5u, 25u, 125u, 625u, 3125u, 15625u, 78125u, 390625u, 1953125u,
	9765625u, 48828125u, 244140625u, 1220703125u, 6103515625u,
	30517578125u, 152587890625u, 762939453125u, 3814697265625u,
	19073486328125u, 95367431640625u, 476837158203125u,
	2384185791015625u, 11920928955078125u, 59604644775390625u,
	298023223876953125u, 1490116119384765625u, 7450580596923828125u,
};

/* For each of them, shifted to d with its highest bit set: floor((2^128 - 1) /
 * d) - 2^64. */
static const uint64_t reciprocals[POWER_IN_64_BITS + 1] = {
	0xffffffffffffffffu, 0x9999999999999999u, 0x47ae147ae147ae14u,
	0x0624dd2f1a9fbe76u, 0xa36e2eb1c432ca57u, 0x4f8b588e368f0846u,
	0x0c6f7a0b5ed8d36bu, 0xad7f29abcaf48578u, 0x5798ee2308c39df9u,
	0x12e0be826d694b2eu, 0xb7cdfd9d7bdbab7du, 0x5fd7fe17964955fdu,
	0x19799812dea11197u, 0xc25c268497681c26u, 0x6849b86a12b9b01eu,
	0x203af9ee756159b2u, 0xcd2b297d889bc2b6u, 0x70ef54646d496892u,
	0x2725dd1d243aba0eu, 0xd83c94fb6d2ac34au, 0x79ca10c9242235d5u,
	0x2e3b40a0e9b4f7ddu, 0xe392010175ee5962u, 0x82db34012b25144eu,
	0x357c299a88ea76a5u, 0xef2d0f5da7dd8aa2u, 0x8c240c4aecb13bb5u,
	0x3ce9a36f23c0fc90u,
};

static const uint64_t powers[8] = {1, 10, 100, 1000, 10000, 100000, 1000000,
    10000000};

/* A number as it is spelt: digits, with the point moved behind the last. */
struct decimal {
	const char *first;    /* first digit; the point may follow */
	const char *last;     /* behind the last digit */
	uint64_t mantissa;    /* all digits, if at most 19 are significant */
	size_t digits;        /* with leading zeros */
	int64_t exponent;     /* of the last digit */
	bool negative;
};

static bool is_digit(const char *p, const char *end)
{
	return p < end && *p >= '0' && *p <= '9';
}

/* Behind the digits at p; they go on from mantissa, modulo 2^64. For few. */
static inline const char *scan_digits(const char *p, const char *end,
    uint64_t *mantissa)
{
	uint64_t m = *mantissa;
	unsigned digit;

	for (; p < end; p++) {
		digit = (unsigned)*p - '0';
		if (digit > 9)
			break;
		m = 10 * m + digit;
	}
	*mantissa = m;
	return p;
}

/* The number of eight digits, a byte each, the first in the lowest one: pairs
 * side by side, then fours, then all. */
static inline uint64_t join_eight(uint64_t digits)
{
	digits = 10 * digits + (digits >> 8);
	return ((digits & 0x000000ff000000ff) * 0x000f424000000064 +
	    (digits >> 16 & 0x000000ff000000ff) * 0x0000271000000001) >> 32;
}

/* The same for many digits: eight at a time. */
static inline const char *scan_long(const char *p, const char *end,
    uint64_t *mantissa)
{
	uint64_t m = *mantissa, digits, others;
	unsigned n;

	while (end - p >= 8) {
		memcpy(&digits, p, sizeof digits);
		digits = le64toh(digits) ^ 0x3030303030303030;
		/* Bytes above 9 get their highest bit; a carry only comes out
		 * of one of them, and behind the first nothing counts. */
		others = ((digits + 0x7676767676767676) | digits) &
		    0x8080808080808080;
		if (others == 0) {
			m = 100000000 * m + join_eight(digits);
			p += 8;
			continue;
		}
		n = (unsigned)__builtin_ctzll(others) / 8;
		/* n digits with zeros before them; n may be 0. */
		digits = digits << 8 * (7 - n) << 8;
		*mantissa = powers[n] * m + join_eight(digits);
		return p + n;
	}
	*mantissa = m;
	return scan_digits(p, end, mantissa);
}

/* *cursor at 'e'; the digits behind it, or NULL with *cursor at the fault. */
static const char *scan_exponent(const char **cursor, const char *end,
    int64_t *out)
{
	const char *p = *cursor + 1;
	const bool negative = p < end && *p == '-';
	int64_t value = 0;

	if (p < end && (*p == '-' || *p == '+'))
		p++;
	*cursor = p;
	if (!is_digit(p, end))
		return NULL;
	for (; is_digit(p, end); p++) {
		if (value < EXPONENT_READ_MAX)
			value = 10 * value + (*p - '0');
	}
	*out = negative ? -value : value;
	return p;
}

static int scan(const char **cursor, const char *end, struct decimal *d)
{
	const char *p = *cursor, *point;
	int64_t exponent = 0;

	d->negative = p < end && *p == '-';
	if (d->negative)
		*cursor = ++p;
	if (!is_digit(p, end))
		return -1;
	if (*p == '0' && is_digit(p + 1, end)) {
		*cursor = p + 1;
		return -1;
	}
	d->first = p;
	d->mantissa = 0;
	p = scan_digits(p, end, &d->mantissa);
	d->digits = (size_t)(p - d->first);
	if (p < end && *p == '.') {
		*cursor = point = p + 1;
		p = scan_long(point, end, &d->mantissa);
		if (p == point)
			return -1;
		d->digits += (size_t)(p - point);
		exponent = -(int64_t)(p - point);
	}
	d->last = p;
	d->exponent = exponent;
	if (p < end && (*p == 'e' || *p == 'E')) {
		*cursor = p;
		p = scan_exponent(cursor, end, &exponent);
		if (!p)
			return -1;
		d->exponent += exponent;
	}
	*cursor = p;
	return 0;
}

/* The digits of d from the first that is not 0. */
static size_t significant(const struct decimal *d)
{
	size_t zeros = 0;
	const char *p;

	if (d->digits <= DIGITS_IN_64_BITS)
		return d->digits;
	for (p = d->first; p < d->last && (*p == '0' || *p == '.'); p++)
		zeros += *p == '0';
	return d->digits - zeros;
}

/* 2^exponent, a normal double. */
static inline double power_of_two(int exponent)
{
	const uint64_t bits = (uint64_t)(1023 + exponent) << 52;
	double power;

	memcpy(&power, &bits, sizeof power);
	return power;
}

/* numerator * 2^exponent, sticky: it stands for a little more. Nearest, ties
 * to even; numerator has more than 54 bits or sticky is false. The result is
 * a normal double. */
static inline double round_to_double(uint64_t numerator, bool sticky,
    int exponent)
{
	const int shift = 64 - __builtin_clzll(numerator) - 53;
	uint64_t kept, rest, half;

	if (shift <= 0)
		return (double)numerator * power_of_two(exponent);
	kept = numerator >> shift;
	rest = numerator & (((uint64_t)1 << shift) - 1);
	half = (uint64_t)1 << (shift - 1);
	/* Not by branches, which cannot be foreseen. */
	kept += (rest > half) |
	    ((rest == half) & (sticky | (unsigned)(kept & 1)));
	return (double)kept * power_of_two(exponent + shift);
}

/* m 10^e = m 5^e 2^e with the product exact in 128 bits. */
static double scale_up(uint64_t m, int e)
{
	__extension__ const unsigned __int128 wide =
	    (unsigned __int128)m * fives[e];
	const uint64_t high = (uint64_t)(wide >> 64), low = (uint64_t)wide;
	int lead;

	if (high == 0)
		return round_to_double(low, false, e);
	lead = __builtin_clzll(high);
	if (lead == 0)
		return round_to_double(high, low != 0, e + 64);
	return round_to_double(high << lead | low >> (64 - lead),
	    (low << lead) != 0, e + 64 - lead);
}

/*
 * The quotient of high 2^64 + low by d, high < d, whose highest bit is set and
 * whose reciprocal is known; *exact says whether nothing is left. N. Moller,
 * T. Granlund, "Improved division by invariant integers" (2011), algorithm 4.
 */
static inline uint64_t divide(uint64_t high, uint64_t low, uint64_t d,
    uint64_t reciprocal, bool *exact)
{
	__extension__ const unsigned __int128 q =
	    (unsigned __int128)reciprocal * high +
	    ((unsigned __int128)high << 64 | low);
	uint64_t quotient = (uint64_t)(q >> 64) + 1;
	uint64_t rest = low - quotient * d;
	const uint64_t over = rest > (uint64_t)q;

	quotient -= over;
	rest += -over & d;
	if (__builtin_expect(rest >= d, 0)) {
		quotient++;
		rest -= d;
	}
	*exact = rest == 0;
	return quotient;
}

/* m 10^-e = m / 5^e 2^-e; quotient of 64 bits or so, remainder sticky. */
static inline double scale_down(uint64_t m, int e)
{
	const int lead = __builtin_clzll(m);
	const int room = __builtin_clzll(fives[e]);
	bool exact;
	/* Both have their highest bit set, so the quotient, of half of m and
	 * 63 bits more, has 63 or 64 bits. */
	const uint64_t quotient = divide(m << lead >> 1, m << lead << 63,
	    fives[e] << room, reciprocals[e], &exact);

	return round_to_double(quotient, !exact, room - lead - 63 - e);
}

/* Digits without a point, then an exponent: no locale changes that. */
static double slow(const struct decimal *d)
{
	char text[DIGITS_THAT_COUNT + 32];
	size_t n = 0;
	int64_t exponent = d->exponent;
	bool rest = false;
	const char *p;

	for (p = d->first; p < d->last; p++) {
		if (*p == '.' || (n == 0 && *p == '0'))
			continue;
		if (n < DIGITS_THAT_COUNT) {
			text[n++] = *p;
		} else {
			exponent++;
			rest = rest || *p != '0';
		}
	}
	/* What was dropped matters only by not being 0. */
	if (rest) {
		text[n++] = '1';
		exponent--;
	}
	if (exponent > EXPONENT_CAP)
		exponent = EXPONENT_CAP;
	if (exponent < -EXPONENT_CAP)
		exponent = -EXPONENT_CAP;
	snprintf(text + n, sizeof text - n, "e%ld", (long)exponent);
	return strtod(text, NULL);
}

static double nearest(const struct decimal *d)
{
	if (significant(d) > DIGITS_IN_64_BITS)
		return slow(d);
	if (d->mantissa == 0)
		return 0.0;
	if (d->exponent > POWER_IN_64_BITS || d->exponent < -POWER_IN_64_BITS)
		return slow(d);
	if (d->mantissa >> 53 || llabs(d->exponent) > POWER_IN_DOUBLE) {
		return d->exponent < 0 ?
		    scale_down(d->mantissa, (int)-d->exponent) :
		    scale_up(d->mantissa, (int)d->exponent);
	}
	return d->exponent < 0 ?
	    (double)d->mantissa / tens[-d->exponent] :
	    (double)d->mantissa * tens[d->exponent];
}

const char *number_parse_plain(const char *p, const char *end, double *out)
{
	const bool negative = p < end && *p == '-';
	const char *first = p + negative, *point;
	uint64_t m = 0;
	size_t whole, fraction = 0;
	double value;

	point = p = scan_digits(first, end, &m);
	whole = (size_t)(point - first);
	if (whole == 0 || (whole > 1 && *first == '0') || p == end)
		return NULL;
	if (*p == '.') {
		p = scan_long(point + 1, end, &m);
		fraction = (size_t)(p - point) - 1;
		if (fraction == 0 || p == end)
			return NULL;
	}
	if (whole + fraction > DIGITS_IN_64_BITS || (*p | 0x20) == 'e')
		return NULL;
	value = m >> 53 ? scale_down(m, (int)fraction) :
	    (double)m / tens[fraction];
	/* Not by a branch: signs cannot be foreseen. */
	*out = signs[negative] * value;
	return p;
}

int number_parse(const char **cursor, const char *end, double *out)
{
	const char *behind = number_parse_plain(*cursor, end, out);
	struct decimal d;

	if (behind) {
		*cursor = behind;
		return 0;
	}
	if (scan(cursor, end, &d))
		return -1;
	*out = signs[d.negative] * nearest(&d);
	return 0;
}
