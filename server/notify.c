#include "server/notify.h"

#include <stdint.h>
#include <sys/socket.h>
#include <systemd/sd-daemon.h>
#include <time.h>

#include "server/log.h"

void notify_ready(void)
{
	sd_notify(0, "READY=1");
}

/* A manager that restarts timers by it wants the time that it began at, by the
 * clock that stands still for nobody. */
void notify_reloading(void)
{
	struct timespec now;

	clock_gettime(CLOCK_MONOTONIC, &now);
	sd_notifyf(0, "RELOADING=1\nMONOTONIC_USEC=%llu",
	    (unsigned long long)now.tv_sec * 1000000 +
	    (unsigned long long)now.tv_nsec / 1000);
}

void notify_stopping(void)
{
	sd_notify(0, "STOPPING=1");
}

void notify_status(const char *text)
{
	sd_notifyf(0, "STATUS=%s", text);
}

/* Once a second is often enough: the shortest that a manager should ask for is
 * several. */
void notify_alive(void)
{
	uint64_t microseconds;

	if (sd_watchdog_enabled(0, &microseconds) > 0)
		sd_notify(0, "WATCHDOG=1");
}

void notify_patience(unsigned seconds)
{
	sd_notifyf(0, "EXTEND_TIMEOUT_USEC=%llu", seconds * 1000000ULL);
}

int notify_listener(void)
{
	/* And so no child sees them as its own. */
	int count = sd_listen_fds(1);

	if (count == 0)
		return -1;
	if (count < 0 || count > 1) {
		log_write(LOG_ERROR, "the service manager must pass one "
		    "socket, not %d", count);
		return -2;
	}
	if (sd_is_socket(SD_LISTEN_FDS_START, AF_UNSPEC, SOCK_STREAM, 1) <= 0) {
		log_write(LOG_ERROR, "the service manager must pass a stream "
		    "socket that listens");
		return -2;
	}
	return SD_LISTEN_FDS_START;
}
