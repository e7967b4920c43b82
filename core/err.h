/*
 * The one list of errors. Every function that can fail returns one of these;
 * ERR_OK is 0. Results travel through trailing pointers, which a failure
 * leaves untouched.
 */
#ifndef CORE_ERR_H
#define CORE_ERR_H

enum err {
	ERR_OK = 0,
	ERR_MEMORY,      /* the host could not allocate */
	ERR_SYNTAX,      /* text that is not what its media type says */
	ERR_INVALID,     /* well-formed, but not allowed: a wrong field or value */
	ERR_LIMIT,       /* larger than a configured limit */
	ERR_NOT_FOUND,   /* no such scene, operator or device */
	ERR_CONFLICT,    /* already there, or changed meanwhile */
	ERR_BUSY,        /* a bounded queue is full: try again */
	ERR_CANCELLED,   /* given up before it ran: shutdown, or nobody waits */
	ERR_DEADLINE,    /* not done by the time that was asked for */
	ERR_OVERTIME,    /* took longer than anything may */
	ERR_DEVICE,      /* an OpenCL call failed */
	ERR_DEVICE_BUILD,/* the device's compiler refused a kernel */
	ERR_DEVICE_MEMORY,/* the device, or our share of it, is full */
	ERR_IO,          /* a system call failed */
	ERR_UNAVAILABLE, /* a disk or a server that this needs is away: try again */
	ERR_COUNT        /* number of values above; not an error */
};

/*
 * A short lower-case English phrase for err, never NULL. A value outside the
 * list gives "unknown error".
 */
const char *err_message(enum err err);

#endif
