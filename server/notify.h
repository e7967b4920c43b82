/*
 * The service manager's side (sd_notify, socket activation): does nothing where
 * there is none. See sd_notify(3), sd_listen_fds(3), sd_watchdog_enabled(3).
 *
 * Threads: notify_status and notify_ready by any, the rest by the main one.
 */
#ifndef SERVER_NOTIFY_H
#define SERVER_NOTIFY_H

/* READY=1: once evaluations are answered. */
void notify_ready(void);

/* RELOADING=1 and, after it, READY=1. */
void notify_reloading(void);

/* STOPPING=1 */
void notify_stopping(void);

/* STATUS=text, for systemctl status. */
void notify_status(const char *text);

/* WATCHDOG=1, if the manager asks for it; call about once a second. */
void notify_alive(void);

/* EXTEND_TIMEOUT_USEC: what the manager waits for, the start or the end, takes
 * so many seconds more from now. */
void notify_patience(unsigned seconds);

/* The listening socket that the manager passed, or -1; -2: more than one, or
 * none that listens (logged). Once. */
int notify_listener(void);

#endif
