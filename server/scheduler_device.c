/*
 * Opening the device, losing it and opening it anew.
 *
 * A call that fails with ERR_DEVICE may be the device's end: a driver that was
 * reset, a card that fell off the bus. What it was for fails with it; then the
 * device is closed with all that was loaded into it, and opened again, at once
 * the first time, later and later while it fails again. Jobs wait meanwhile,
 * for so long that a driver can be restarted; then they are told, as are those
 * that come, until the device is back. Tapes and tables are loaded again as
 * jobs need them.
 */
#include "server/scheduler_internal.h"

#include <math.h>
#include <stdio.h>

#include "server/clock.h"
#include "server/log.h"

/* Seconds between attempts to open a lost device. */
#define PAUSE_LEAST 0.1
#define PAUSE_MOST 10.0

/* Seconds between a loss and the first attempt, at most. */
#define LOSS_PAUSE_MOST 1.0

/* Seconds after a loss from which on another is taken for the first. */
#define FORGIVEN 30.0

/* Seconds that jobs wait for a device that is away, if nothing is said. */
#define PATIENCE 30.0

/* Seconds after which a launch that does not end is taken for one that never
 * will, likewise: pieces of a job take some milliseconds. */
#define HANG 60.0

/* Calls in a row for which the device finds no memory of the host's, after
 * which it is taken for lost: its driver leaks, or cannot be believed. */
#define SHORTAGES 8

static void describe(struct scheduler *s, const char *what, enum err err,
    const char *message)
{
	snprintf(s->why, sizeof s->why, "%s: %s%s%s", what, err_message(err),
	    message[0] != '\0' ? ": " : "", message);
}

void scheduler_device_break(struct scheduler *s, enum err err,
    const char *what, const char *message)
{
	s->broken = err;
	describe(s, what, err, message);
	log_write(LOG_ERROR, "%s", s->why);
}

/* The device is there: says so. */
static void publish(struct scheduler *s, double seconds)
{
	const struct device_info *info = device_get_info(s->device);

	log_write(LOG_INFO, "device %s: width %d, tables as %s, ready in "
	    "%.0f ms", info->name, info->width,
	    info->tables_are_images ? "images" : "buffers", 1e3 * seconds);
	pthread_mutex_lock(&s->lock);
	s->stats.device = *info;
	pthread_mutex_unlock(&s->lock);
	scheduler_tables_publish(s);
}

void scheduler_device_open(struct scheduler *s)
{
	struct device_failure failure = {0};
	double begin = clock_seconds();
	enum err err = device_open(&s->options.device, &s->device, &failure);

	if (err == ERR_OK) {
		publish(s, clock_seconds() - begin);
		return;
	}
	scheduler_device_break(s, err, "device", failure.message);
	if (failure.build_log != NULL)
		log_text(LOG_ERROR, failure.build_log);
	device_failure_fini(&failure);
	s->options.failed(s->options.ctx);
}

/* The next attempt is to come after a pause, longer than the last. */
static void put_off(struct scheduler *s)
{
	s->reopen_at = clock_seconds() + s->pause;
	s->pause = fmin(fmax(2.0 * s->pause, PAUSE_LEAST), PAUSE_MOST);
}

/* Closes the device; what it held is to be made again. */
static void close_device(struct scheduler *s)
{
	scheduler_tables_unload_all(s);
	device_close(s->device);
	s->device = NULL;
	tables_lose(s->options.tables);
	s->changes++;
	s->shortages = 0;
	pthread_mutex_lock(&s->lock);
	s->stats.ready = false;
	pthread_mutex_unlock(&s->lock);
	scheduler_tables_publish(s);
}

/* Seconds since the device was lost. */
static double away(const struct scheduler *s)
{
	return clock_seconds() - s->lost_at;
}

void scheduler_device_check(struct scheduler *s, enum err err)
{
	if (err == ERR_OK)
		s->shortages = 0;
	s->shortages += err == ERR_MEMORY;
	if (err != ERR_DEVICE && s->shortages < SHORTAGES)
		return;
	describe(s, "the device is lost", err, device_message(s->device));
	log_write(LOG_ERROR, "%s; opening it anew", s->why);
	/* Those that wait for a table that has failed fail with it. */
	scheduler_run_fail_waiting(s);
	/* What others do well in between does not make a program harmless by
	 * which it is lost again and again. */
	s->pause = away(s) < FORGIVEN ? s->loss_pause : 0.0;
	s->lost_at = clock_seconds();
	close_device(s);
	put_off(s);
	s->loss_pause = fmin(s->pause, LOSS_PAUSE_MOST);
}

/* The device is there again. */
static void welcome(struct scheduler *s, double seconds)
{
	publish(s, seconds);
	s->changes++;
	log_write(LOG_WARNING, "the device is back after %.2f s", away(s));
	pthread_mutex_lock(&s->lock);
	s->stats.rebuilds++;
	pthread_mutex_unlock(&s->lock);
	if (s->options.rebuilt != NULL)
		s->options.rebuilt(s->options.ctx);
}

bool scheduler_device_reopen(struct scheduler *s)
{
	struct device_failure failure = {0};
	double begin = clock_seconds();
	enum err err;

	if (s->device != NULL || s->broken != ERR_OK ||
	    atomic_load(&s->cancel) || begin < s->reopen_at)
		return false;
	err = device_open(&s->options.device, &s->device, &failure);
	if (err == ERR_OK) {
		welcome(s, clock_seconds() - begin);
		return true;
	}
	put_off(s);
	describe(s, "the device is lost", err, failure.message);
	log_write(LOG_ERROR, "%s, for %.1f s; the next attempt follows in "
	    "%.1f s", s->why, away(s), s->reopen_at - clock_seconds());
	device_failure_fini(&failure);
	return false;
}

bool scheduler_device_is_given_up(const struct scheduler *s)
{
	return s->device == NULL && s->broken == ERR_OK && away(s) >
	    (s->options.patience > 0.0 ? s->options.patience : PATIENCE);
}

double scheduler_device_next_look(const struct scheduler *s)
{
	return s->device == NULL && s->broken == ERR_OK ? s->reopen_at :
	    INFINITY;
}

void scheduler_device_begin(struct scheduler *s)
{
	pthread_mutex_lock(&s->lock);
	s->stats.busy_since = clock_seconds();
	pthread_mutex_unlock(&s->lock);
}

void scheduler_device_end(struct scheduler *s)
{
	pthread_mutex_lock(&s->lock);
	s->stats.busy_since = 0.0;
	pthread_mutex_unlock(&s->lock);
}

/* ---- other threads ---- */

static double patience_with_launch(const struct scheduler *s)
{
	return s->options.hang > 0.0 ? s->options.hang : HANG;
}

bool scheduler_device_hangs(const struct scheduler *s)
{
	return s->stats.busy_since > 0.0 && clock_seconds() -
	    s->stats.busy_since > patience_with_launch(s);
}

bool scheduler_watch(struct scheduler *s)
{
	bool hangs, is_new;

	pthread_mutex_lock(&s->lock);
	hangs = scheduler_device_hangs(s);
	is_new = hangs && !s->hang_logged;
	s->hang_logged = hangs;
	pthread_mutex_unlock(&s->lock);
	if (is_new)
		log_write(LOG_ERROR, "the device has been busy with one launch "
		    "for more than %.0f s: not ready; only a restart of the "
		    "daemon can help", patience_with_launch(s));
	return !hangs;
}
