/*
 * Preloaded into the daemon: memory, files, sockets and threads that are
 * refused when told to. Memory only where the program itself, cJSON or SQLite
 * ask for it: PoCL, LLVM, libmicrohttpd and GnuTLS may end the process when
 * there is none, which is not ours to mend. Of files those in a folder, whoever
 * writes.
 */
#include "tests/fault/inside.h"

#include <errno.h>
#include <pthread.h>
#include <stdarg.h>
#include <sys/sendfile.h>
#include <sys/socket.h>
#include <sys/uio.h>

/* glibc's own allocator, under names that cannot be replaced. */
void *__libc_malloc(size_t size);
void *__libc_calloc(size_t count, size_t size);
void *__libc_realloc(void *old, size_t size);
void *__libc_memalign(size_t alignment, size_t size);

#define REAL(name) \
	static _Atomic(void *) real; \
	FIND(real, #name)
#define CALL(name, ...) \
	((__typeof__(&name))(uintptr_t)atomic_load(&real))(__VA_ARGS__)

/* ---- memory ---- */

static bool is_refused(const char *name, const void *address)
{
	if (control == NULL || !is_from_ours(address) ||
	    !fails(FAULT_ALLOC, name, address))
		return false;
	errno = ENOMEM;
	return true;
}

void *malloc(size_t size)
{
	return is_refused("malloc", HERE) ? NULL : __libc_malloc(size);
}

void *calloc(size_t count, size_t size)
{
	return is_refused("calloc", HERE) ? NULL : __libc_calloc(count, size);
}

void *realloc(void *old, size_t size)
{
	return is_refused("realloc", HERE) ? NULL : __libc_realloc(old, size);
}

void *aligned_alloc(size_t alignment, size_t size)
{
	return is_refused("aligned_alloc", HERE) ? NULL :
	    __libc_memalign(alignment, size);
}

int posix_memalign(void **out, size_t alignment, size_t size)
{
	void *p;

	if (is_refused("posix_memalign", HERE) ||
	    (p = __libc_memalign(alignment, size)) == NULL)
		return ENOMEM;
	*out = p;
	return 0;
}

char *strdup(const char *text)
{
	size_t size = strlen(text) + 1;
	char *copy = is_refused("strdup", HERE) ? NULL : __libc_malloc(size);

	return copy == NULL ? NULL : memcpy(copy, text, size);
}

int asprintf(char **out, const char *format, ...)
{
	va_list args;
	int n = -1;

	va_start(args, format);
	if (!is_refused("asprintf", HERE))
		n = vasprintf(out, format, args);
	va_end(args);
	return n;
}

/* ---- files ---- */

static bool is_below(const char *path)
{
	size_t length = strlen(control->folder);

	return length > 0 && strncmp(path, control->folder, length) == 0;
}

static bool is_file(int fd)
{
	char link[64], path[4096];
	ssize_t n;

	if (control == NULL || control->folder[0] == '\0')
		return false;
	snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
	n = readlink(link, path, sizeof path - 1);
	path[n > 0 ? n : 0] = '\0';
	return is_below(path);
}

/* Of a write of *size bytes: what is left of it, or that it fails. */
static bool is_unwritten(const char *name, int fd, size_t *size,
    const void *address)
{
	if (!is_file(fd) || !fails(FAULT_WRITE, name, address))
		return false;
	errno = atomic_load(&control->code);
	if (errno != 0)
		return true;
	*size = (*size + 1) / 2;
	return false;
}

ssize_t write(int fd, const void *from, size_t size)
{
	REAL(write);
	if (is_unwritten("write", fd, &size, HERE))
		return -1;
	return CALL(write, fd, from, size);
}

ssize_t pwrite(int fd, const void *from, size_t size, off_t at)
{
	REAL(pwrite);
	if (is_unwritten("pwrite", fd, &size, HERE))
		return -1;
	return CALL(pwrite, fd, from, size, at);
}

ssize_t pwrite64(int fd, const void *from, size_t size, off64_t at)
{
	REAL(pwrite64);
	if (is_unwritten("pwrite64", fd, &size, HERE))
		return -1;
	return CALL(pwrite64, fd, from, size, at);
}

static bool is_kept_as_long(const char *name, int fd, const void *address)
{
	if (!is_file(fd) || !fails(FAULT_WRITE, name, address))
		return false;
	errno = atomic_load(&control->code);
	errno = errno != 0 ? errno : EIO;
	return true;
}

int ftruncate(int fd, off_t size)
{
	REAL(ftruncate);
	return is_kept_as_long("ftruncate", fd, HERE) ? -1 :
	    CALL(ftruncate, fd, size);
}

int ftruncate64(int fd, off64_t size)
{
	REAL(ftruncate64);
	return is_kept_as_long("ftruncate64", fd, HERE) ? -1 :
	    CALL(ftruncate64, fd, size);
}

static bool is_unsynced(const char *name, int fd, const void *address)
{
	if (!is_file(fd) || !fails(FAULT_SYNC, name, address))
		return false;
	errno = EIO;
	return true;
}

int fsync(int fd)
{
	REAL(fsync);
	return is_unsynced("fsync", fd, HERE) ? -1 : CALL(fsync, fd);
}

int fdatasync(int fd)
{
	REAL(fdatasync);
	return is_unsynced("fdatasync", fd, HERE) ? -1 : CALL(fdatasync, fd);
}

static bool is_closed(const char *name, const char *path, const void *address)
{
	if (control == NULL || !is_below(path) ||
	    !fails(FAULT_OPEN, name, address))
		return false;
	errno = atomic_load(&control->code);
	errno = errno != 0 ? errno : EMFILE;
	return true;
}

static mode_t mode_of(int flags, va_list args)
{
	return flags & (O_CREAT | O_TMPFILE) ? va_arg(args, mode_t) : 0;
}

int open(const char *path, int flags, ...)
{
	va_list args;
	mode_t mode;

	REAL(open);
	va_start(args, flags);
	mode = mode_of(flags, args);
	va_end(args);
	return is_closed("open", path, HERE) ? -1 :
	    CALL(open, path, flags, mode);
}

int open64(const char *path, int flags, ...)
{
	va_list args;
	mode_t mode;

	REAL(open64);
	va_start(args, flags);
	mode = mode_of(flags, args);
	va_end(args);
	return is_closed("open64", path, HERE) ? -1 :
	    CALL(open64, path, flags, mode);
}

/* ---- sockets ---- */

static bool is_unsent(const char *name, const void *address)
{
	if (!fails(FAULT_SEND, name, address))
		return false;
	errno = ECONNRESET;
	return true;
}

ssize_t send(int fd, const void *from, size_t size, int flags)
{
	REAL(send);
	return is_unsent("send", HERE) ? -1 : CALL(send, fd, from, size, flags);
}

ssize_t sendmsg(int fd, const struct msghdr *message, int flags)
{
	REAL(sendmsg);
	return is_unsent("sendmsg", HERE) ? -1 :
	    CALL(sendmsg, fd, message, flags);
}

ssize_t writev(int fd, const struct iovec *parts_, int count)
{
	REAL(writev);
	return is_unsent("writev", HERE) ? -1 : CALL(writev, fd, parts_, count);
}

ssize_t sendfile(int fd, int from, off_t *at, size_t size)
{
	REAL(sendfile);
	return is_unsent("sendfile", HERE) ? -1 :
	    CALL(sendfile, fd, from, at, size);
}

/* ---- threads ---- */

int pthread_create(pthread_t *out, const pthread_attr_t *attributes,
    void *(*begin)(void *ctx), void *ctx)
{
	REAL(pthread_create);
	if (control != NULL && is_from_ours(HERE) &&
	    fails(FAULT_THREAD, "pthread_create", HERE))
		return EAGAIN;
	return CALL(pthread_create, out, attributes, begin, ctx);
}
