/*
 * The kernels' source text, one string: core/opcode.h and the .cl files in the
 * Makefile's order. Written by kernels/embed.awk at build time.
 */
#ifndef KERNELS_SOURCE_H
#define KERNELS_SOURCE_H

extern const char kernels_source[];

#endif
