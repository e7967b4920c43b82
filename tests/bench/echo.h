/*
 * The yardstick of the wire: a bare libmicrohttpd server, set up as the daemon's
 * is, that reads a POST body and answers with as many bytes as its path says.
 */
#ifndef TESTS_BENCH_ECHO_H
#define TESTS_BENCH_ECHO_H

struct MHD_Daemon;

/* Listens on a free port of 127.0.0.1, in *port; aborts on failure. */
struct MHD_Daemon *echo_start(int *port);
void echo_stop(struct MHD_Daemon *echo);

#endif
