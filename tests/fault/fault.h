/*
 * What a test and the library preloaded into the daemon share: a file, named by
 * the environment variable FAULT_CONTROL, mapped by both. The test says which
 * calls are to fail, while the daemon runs; the library counts them.
 *
 * Neither library does anything without that variable.
 */
#ifndef TESTS_FAULT_FAULT_H
#define TESTS_FAULT_FAULT_H

#include <stdatomic.h>

enum fault_kind {
	FAULT_CL,    /* fail_cl.c: OpenCL, but for what releases things */
	FAULT_ALLOC, /* fail_libc.c: memory asked for by the program, cJSON or
	              * SQLite */
	FAULT_WRITE, /* ... write, pwrite, ftruncate of a file in folder */
	FAULT_SYNC,  /* ... fsync, fdatasync of one */
	FAULT_OPEN,  /* ... open of one */
	FAULT_SEND,  /* ... send, sendmsg, writev, sendfile to a socket */
	FAULT_THREAD,/* ... pthread_create by the program */
	FAULT_KINDS
};

struct fault_control {
	atomic_ulong calls[FAULT_KINDS]; /* since the test has set it to 0 */
	atomic_int kind;           /* that fails; FAULT_KINDS: none */
	atomic_ulong first, last;  /* those calls, counted from 1 */
	atomic_int code;           /* the OpenCL error or errno; of a write, 0:
	                            * only half of it is written */
	atomic_ulong failed;       /* how many have */
	atomic_ulong at;           /* the last one: where in the program, of
	                            * its callers the first one there */
	char name[32];             /* of the last one */
	char folder[4096];
};

#endif
