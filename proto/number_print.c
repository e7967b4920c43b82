/*
 * float32 to the shortest decimal that reads back: Raffaello Giulietti's
 * Schubfach (2020). The decimals that round to f lie between the middles to
 * its neighbours; both ends, scaled by a power of ten to integers of a few
 * digits more than f has, are found exactly enough with 64 bits of that power.
 */
#include "proto/number.h"

#include <assert.h>
#include <endian.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#define POWER_FIRST (-31)
#define POWER_LAST 45

/* 10^k for k = POWER_FIRST..POWER_LAST: its first 64 bits, rounded up. */
static const uint64_t powers[POWER_LAST - POWER_FIRST + 1] = {
	0x81ceb32c4b43fcf5u, 0xa2425ff75e14fc32u, 0xcad2f7f5359a3b3fu,
	0xfd87b5f28300ca0eu, 0x9e74d1b791e07e49u, 0xc612062576589ddbu,
	0xf79687aed3eec552u, 0x9abe14cd44753b53u, 0xc16d9a0095928a28u,
	0xf1c90080baf72cb2u, 0x971da05074da7befu, 0xbce5086492111aebu,
	0xec1e4a7db69561a6u, 0x9392ee8e921d5d08u, 0xb877aa3236a4b44au,
	0xe69594bec44de15cu, 0x901d7cf73ab0acdau, 0xb424dc35095cd810u,
	0xe12e13424bb40e14u, 0x8cbccc096f5088ccu, 0xafebff0bcb24aaffu,
	0xdbe6fecebdedd5bfu, 0x89705f4136b4a598u, 0xabcc77118461cefdu,
	0xd6bf94d5e57a42bdu, 0x8637bd05af6c69b6u, 0xa7c5ac471b478424u,
	0xd1b71758e219652cu, 0x83126e978d4fdf3cu, 0xa3d70a3d70a3d70bu,
	0xcccccccccccccccdu, 0x8000000000000000u, 0xa000000000000000u,
	0xc800000000000000u, 0xfa00000000000000u, 0x9c40000000000000u,
	0xc350000000000000u, 0xf424000000000000u, 0x9896800000000000u,
	0xbebc200000000000u, 0xee6b280000000000u, 0x9502f90000000000u,
	0xba43b74000000000u, 0xe8d4a51000000000u, 0x9184e72a00000000u,
	0xb5e620f480000000u, 0xe35fa931a0000000u, 0x8e1bc9bf04000000u,
	0xb1a2bc2ec5000000u, 0xde0b6b3a76400000u, 0x8ac7230489e80000u,
	0xad78ebc5ac620000u, 0xd8d726b7177a8000u, 0x878678326eac9000u,
	0xa968163f0a57b400u, 0xd3c21bcecceda100u, 0x84595161401484a0u,
	0xa56fa5b99019a5c8u, 0xcecb8f27f4200f3au, 0x813f3978f8940985u,
	0xa18f07d736b90be6u, 0xc9f2c9cd04674edfu, 0xfc6f7c4045812297u,
	0x9dc5ada82b70b59eu, 0xc5371912364ce306u, 0xf684df56c3e01bc7u,
	0x9a130b963a6c115du, 0xc097ce7bc90715b4u, 0xf0bdc21abb48db21u,
	0x96769950b50d88f5u, 0xbc143fa4e250eb32u, 0xeb194f8e1ae525feu,
	0x92efd1b8d0cf37bfu, 0xb7abc627050305aeu, 0xe596b7b0c643c71au,
	0x8f7e32ce7bea5c70u, 0xb35dbf821ae4f38cu,
};

static const uint32_t pow10s[] = {1, 10, 100, 1000, 10000, 100000, 1000000,
    10000000, 100000000, 1000000000};

/* digits 10^exponent */
struct decimal {
	uint32_t digits;
	int exponent;
};

/* Floors of q log10(2), q log10(2) + log10(3/4), and k log2(10); the
 * multipliers hold far beyond float32's range. */
static int floor_log10_pow2(int q)
{
	return (q * 1262611) >> 22;
}

static int floor_log10_three_quarters_pow2(int q)
{
	return (q * 1262611 - 524031) >> 22;
}

static int floor_log2_pow10(int k)
{
	return (k * 1741647) >> 19;
}

/* The integer part of power * x / 2^64, its last bit set if a fraction that
 * the power's rounding cannot explain was left. */
static uint32_t scale_to_odd(uint64_t power, uint32_t x)
{
	const uint64_t low = (power & UINT32_MAX) * x;
	const uint64_t high = (power >> 32) * x + (low >> 32);

	return (uint32_t)(high >> 32) |
	    (uint32_t)(((high & UINT32_MAX) + UINT32_MAX - 1) >> 32);
}

/* 1 if a < b, both below 2^31. Not by a comparison: on x86 that leaves a
 * register's upper part as the number before left it, and so waits for it. */
static uint32_t less(uint32_t a, uint32_t b)
{
	return (a - b) >> 31;
}

/* a if which is 1, b if it is 0. */
static uint32_t choose(uint32_t which, uint32_t a, uint32_t b)
{
	return b ^ (-which & (a ^ b));
}

/* f = c 2^q, c > 0. narrow: the neighbour below is half as far as the one
 * above. The digits may end in zeros. Which of the two candidates it is cannot
 * be foreseen, so both are made and no branch chooses. */
static struct decimal shortest(uint32_t c, int q, bool narrow)
{
	const int k = narrow ? floor_log10_three_quarters_pow2(q) :
	    floor_log10_pow2(q);
	const int shift = q + floor_log2_pow10(-k) + 1;
	const uint64_t power = powers[-k - POWER_FIRST];
	/* An end belongs to f only if ties, which go to even, come to f. */
	const uint32_t open = c & 1;
	const uint32_t least = scale_to_odd(power,
	    (4 * c - (narrow ? 1 : 2)) << shift) + open;
	const uint32_t most = scale_to_odd(power, (4 * c + 2) << shift) - open;
	const uint32_t value = scale_to_odd(power, (4 * c) << shift);
	const uint32_t whole = value / 4, tens = whole / 10 * 10;
	/* One digit less, if just one such number lies between the ends (where
	 * that leaves none, both ways come to the same). */
	const uint32_t tens_below = 1 - less(4 * tens, least);
	const uint32_t tens_above = 1 - less(most, 4 * tens + 40);
	const uint32_t below = 1 - less(4 * whole, least);
	const uint32_t above = 1 - less(most, 4 * whole + 4);
	/* Up if above half, or at half, where whole is odd. */
	const uint32_t rounded = ((value & 3) + (whole & 1) + 1) >> 2;
	const uint32_t fewer = tens + 10 * tens_above;
	const uint32_t all = whole + choose(below ^ above, above, rounded);

	return (struct decimal){choose(tens_below ^ tens_above, fewer, all), k};
}

static struct decimal decimal_of(uint32_t bits)
{
	const uint32_t fraction = bits & 0x7fffff;
	const int exponent = (int)(bits >> 23 & 0xff);
	const int normal = exponent > 0;
	const uint32_t c = fraction | (uint32_t)normal << 23;
	const int q = exponent - 149 - normal;

	return shortest(c, q, fraction == 0 && exponent > 1);
}

/* The nine leading digits of a number as text, zeros following. They stay in
 * registers: stores of single characters would stall the loads behind. */
struct text {
	char first;
	uint64_t others; /* the next eight, the first in the lowest byte */
	int count;       /* up to the last digit that is not 0; at least 1 */
};

/* The eight digits of x < 10^8, a byte each: halves, then quarters, then
 * eighths side by side. 5243/2^19 and 103/2^10 divide by 100 and by 10 that
 * far. */
static uint64_t eight_digits(uint32_t x)
{
	uint64_t v = x / 10000 | (uint64_t)(x % 10000) << 32, tens;

	tens = v * 5243 >> 19 & 0x0000007f0000007f;
	v = tens | (v - 100 * tens) << 16;
	tens = v * 103 >> 10 & 0x000f000f000f000f;
	return tens | (v - 10 * tens) << 8;
}

/* How many bytes of v, each below 128, are not above the last that is not 0. */
static int bytes_used(uint64_t v)
{
	return 8 - __builtin_clzll(v | 1) / 8 - (int)((v - 1) >> 63);
}

/* How many digits x has, 0 < x < 10^9; seldom less than seven. */
static int count_digits(uint32_t x)
{
	uint32_t count = 9 - less(x, pow10s[8]) - less(x, pow10s[7]);

	while (x < pow10s[count - 1])
		count--;
	return (int)count;
}

/* The text of digits, which has that many. */
static struct text spell(uint32_t digits, int size)
{
	uint64_t others;

	digits *= pow10s[9 - size];
	others = eight_digits(digits % pow10s[8]);
	return (struct text){(char)('0' + digits / pow10s[8]),
	    others + 0x3030303030303030, 1 + bytes_used(others)};
}

static void put_eight(uint64_t text, char *out)
{
	text = htole64(text);
	memcpy(out, &text, sizeof text);
}

#define POINT_FIRST (-4)
#define POINT_LAST 9

/*
 * Where things go for each number of digits before the decimal point, from
 * POINT_FIRST on: over "0.000000" the first digit and the others behind it;
 * then the point, and at rest the others once more, without those that stand
 * before the point. Where none stand before it, that changes nothing.
 */
static const struct layout {
	unsigned char first, point, rest, shift;
} layouts[POINT_LAST - POINT_FIRST + 1] = {
	{6, 1, 7, 0}, {5, 1, 6, 0}, {4, 1, 5, 0}, {3, 1, 4, 0}, {2, 1, 3, 0},
	{0, 1, 2, 0}, {0, 2, 3, 8}, {0, 3, 4, 16}, {0, 4, 5, 24}, {0, 5, 6, 32},
	{0, 6, 7, 40}, {0, 7, 8, 48}, {0, 8, 9, 56}, {0, 9, 10, 56},
};

/* point: how many digits stand before the decimal point. */
static size_t plain(const struct text *t, int point, char *out)
{
	const struct layout *at = &layouts[point - POINT_FIRST];
	const int all = t->count + at->first + (at->first == 0);

	memcpy(out, "0.000000", 8);
	out[at->first] = t->first;
	put_eight(t->others, out + at->first + 1);
	out[at->point] = '.';
	put_eight(t->others >> at->shift, out + at->rest);
	return (size_t)(point >= t->count ? point : all);
}

static size_t scientific(const struct text *t, int point, char *out)
{
	int exponent = point - 1;
	char *p = out + (t->count > 1 ? t->count + 1 : 1);

	out[0] = t->first;
	out[1] = '.';
	put_eight(t->others, out + 2);
	*p++ = 'e';
	if (exponent < 0) {
		*p++ = '-';
		exponent = -exponent;
	}
	if (exponent >= 10)
		*p++ = (char)('0' + exponent / 10);
	*p++ = (char)('0' + exponent % 10);
	return (size_t)(p - out);
}

size_t number_print_float(float f, char out[static NUMBER_FLOAT_ROOM])
{
	struct decimal d;
	struct text text;
	uint32_t bits, negative;
	int point, size;

	assert(isfinite(f));
	memcpy(&bits, &f, sizeof bits);
	if (bits << 1 == 0) {
		*out = '0';
		return 1;
	}
	/* Not by a branch: signs cannot be foreseen. */
	negative = bits >> 31;
	*out = '-';
	out += negative;
	d = decimal_of(bits);
	size = count_digits(d.digits);
	text = spell(d.digits, size);
	point = size + d.exponent;
	return negative + (point >= POINT_FIRST && point <= POINT_LAST ?
	    plain(&text, point, out) : scientific(&text, point, out));
}
