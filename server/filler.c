#include "server/filler.h"

#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "kernels/cache_file.h"
#include "kernels/device.h"
#include "kernels/source.h"
#include "server/log.h"

#define KIND "note"

/* How long a failure counts, in seconds. */
#define DAY 86400.0

/* What could make the next try end otherwise. */
static void make_key(struct cache_key *key, const struct device_info *device)
{
	key->size = 0;
	cache_key_add_text(key, "fill");
	cache_key_add_hash(key, kernels_source, strlen(kernels_source));
	cache_key_add_text(key, device->name);
	cache_key_add_text(key, device->vendor);
	cache_key_add_text(key, device->version);
	cache_key_add_text(key, device->driver);
	cache_key_add_int(key, device->width);
	cache_key_add_int(key, device->tables_are_images);
}

static bool has_failed_lately(const struct filler *f,
    const struct device_info *device)
{
	struct cache_key key;
	double age;

	make_key(&key, device);
	age = cache_file_age(f->cache, KIND, &key);
	return age >= 0.0 && age < DAY;
}

/* Becomes the program. The memory is the daemon's until then: nothing here may
 * write to what is not its own. */
_Noreturn static void become(char **argv, int said, pid_t daemon)
{
	sigset_t none;
	int null;

	/* To be told of a death that has been is too late. */
	if (prctl(PR_SET_PDEATHSIG, SIGKILL) != 0 || getppid() != daemon)
		_exit(127);
	dup2(said, STDERR_FILENO);
	null = open("/dev/null", O_RDWR);
	dup2(null, STDIN_FILENO);
	dup2(null, STDOUT_FILENO);
	close_range(STDERR_FILENO + 1, ~0u, 0);
	sigemptyset(&none);
	sigprocmask(SIG_SETMASK, &none, NULL);
	execv("/proc/self/exe", argv);
	_exit(127);
}

static void start(struct filler *f)
{
	static char option[] = "--fill-cache";
	pid_t daemon = getpid();
	char **argv;
	size_t count = 0;

	while (f->argv[count] != NULL)
		count++;
	argv = calloc(count + 2, sizeof *argv);
	if (argv == NULL)
		return;
	memcpy(argv, f->argv, count * sizeof *argv);
	argv[count] = option;
	f->said = memfd_create("said", MFD_CLOEXEC);
	signal(SIGCHLD, SIG_DFL); /* ignored, no child leaves its status */
	/* Not fork, which would copy the tables' pages one by one as they
	 * change, and those that devices have pinned. */
	f->pid = vfork();
	if (f->pid == 0)
		become(argv, f->said, daemon);
	free(argv);
	if (f->pid < 0) {
		close(f->said);
		f->pid = 0;
	}
}

static void repeat(const struct filler *f)
{
	char text[2 * LOG_LINE_MAX];
	ssize_t length = pread(f->said, text, sizeof text - 1, 0);

	text[length > 0 ? length : 0] = '\0';
	log_text(LOG_WARNING, text);
}

static void fail(const struct filler *f, const struct device_info *device)
{
	struct cache_key key;

	repeat(f);
	log_write(LOG_WARNING, "the cache could not be filled with kernels; "
	    "no new attempt for a day, but by --fill-cache");
	make_key(&key, device);
	cache_file_write(f->cache, KIND, &key, "", 0);
}

/* As from a terminal, which tells the daemon too: that is no failure. */
static bool was_told_to_stop(int status)
{
	int number = WIFSIGNALED(status) ? WTERMSIG(status) : 0;

	return number == SIGTERM || number == SIGINT || number == SIGHUP;
}

/* Notices the end of the process. */
static void look(struct filler *f, const struct device_info *device)
{
	int status = 0;
	pid_t ended = waitpid(f->pid, &status, WNOHANG);

	if (ended == 0)
		return;
	if (ended == f->pid && status == 0)
		log_write(LOG_INFO, "kernels are in the cache");
	else if (ended == f->pid && !was_told_to_stop(status))
		fail(f, device);
	f->pid = 0;
	close(f->said);
}

void filler_tend(struct filler *f, const struct device_info *device)
{
	if (f->pid > 0) {
		look(f, device);
		return;
	}
	if (f->has_begun || f->cache == NULL)
		return;
	f->has_begun = true;
	if (device->is_cached)
		return;
	if (has_failed_lately(f, device))
		log_write(LOG_INFO, "the cache is not filled with kernels: "
		    "that has failed within a day");
	else
		start(f);
}

void filler_stop(struct filler *f)
{
	if (f->pid <= 0)
		return;
	kill(f->pid, SIGKILL);
	waitpid(f->pid, NULL, 0);
	close(f->said);
	f->pid = 0;
}
