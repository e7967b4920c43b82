#include "server/backing_redis_tls.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>

#include <gnutls/gnutls.h>
#include <gnutls/x509.h>

#include "server/backing_redis_url.h"
#include "server/clock.h"

/* Nothing older than TLS 1.2, which Redis speaks since it speaks TLS. */
#define PRIORITIES "NORMAL:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2"

struct backing_redis_tls {
	gnutls_certificate_credentials_t credentials;
	gnutls_session_t session;
	int fd;
	int code;                /* of what has failed */
	char why[BACKING_REDIS_TLS_WHY_MAX];
};

/* ---- certificates ---- */

static enum err complain(char *why, const char *what, const char *file,
    int code)
{
	snprintf(why, BACKING_REDIS_TLS_WHY_MAX, "%s%.100s: %s", what, file,
	    gnutls_strerror(code));
	return code == GNUTLS_E_MEMORY_ERROR ? ERR_MEMORY : ERR_INVALID;
}

/* Both return how many they have read. */
static enum err set_trust(gnutls_certificate_credentials_t credentials,
    const struct backing_redis_url *url, char *why)
{
	const char *file = url->ca[0] != '\0' ? url->ca : "";
	int count = file[0] != '\0' ?
	    gnutls_certificate_set_x509_trust_file(credentials, file,
	    GNUTLS_X509_FMT_PEM) :
	    gnutls_certificate_set_x509_system_trust(credentials);

	if (count < 0)
		return complain(why, file[0] != '\0' ? "ca " :
		    "the system's certificates", file, count);
	if (count > 0)
		return ERR_OK;
	snprintf(why, BACKING_REDIS_TLS_WHY_MAX, "%s%.100s: no certificate is "
	    "there", file[0] != '\0' ? "ca " : "the system's certificates",
	    file);
	return ERR_INVALID;
}

static enum err load(const struct backing_redis_url *url,
    gnutls_certificate_credentials_t *out, char *why)
{
	gnutls_certificate_credentials_t credentials;
	int code = gnutls_certificate_allocate_credentials(&credentials);
	enum err err;

	if (code < 0)
		return complain(why, "TLS", "", code);
	err = set_trust(credentials, url, why);
	if (err == ERR_OK && url->cert[0] != '\0') {
		code = gnutls_certificate_set_x509_key_file(credentials,
		    url->cert, url->key, GNUTLS_X509_FMT_PEM);
		if (code < 0)
			err = complain(why, "cert ", url->cert, code);
	}
	if (err != ERR_OK)
		gnutls_certificate_free_credentials(credentials);
	else
		*out = credentials;
	return err;
}

enum err backing_redis_tls_check(const struct backing_redis_url *url,
    char why[static BACKING_REDIS_TLS_WHY_MAX])
{
	gnutls_certificate_credentials_t credentials;
	enum err err = load(url, &credentials, why);

	if (err == ERR_OK)
		gnutls_certificate_free_credentials(credentials);
	return err;
}

/* ---- shaking hands ---- */

static bool is_address(const char *host)
{
	struct in6_addr address;

	return inet_pton(AF_INET, host, &address) == 1 ||
	    inet_pton(AF_INET6, host, &address) == 1;
}

static int make_session(struct backing_redis_tls *tls,
    const struct backing_redis_url *url, unsigned milliseconds)
{
	int code = gnutls_init(&tls->session, GNUTLS_CLIENT |
	    GNUTLS_NO_SIGNAL);

	if (code < 0)
		return code;
	code = gnutls_priority_set_direct(tls->session, PRIORITIES, NULL);
	if (code >= 0)
		code = gnutls_credentials_set(tls->session,
		    GNUTLS_CRD_CERTIFICATE, tls->credentials);
	/* No address is a server's name (RFC 6066, section 3). */
	if (code >= 0 && !is_address(url->host))
		code = gnutls_server_name_set(tls->session, GNUTLS_NAME_DNS,
		    url->host, strlen(url->host));
	gnutls_session_set_verify_cert(tls->session, url->host, 0);
	gnutls_transport_set_int(tls->session, tls->fd);
	gnutls_handshake_set_timeout(tls->session, milliseconds);
	return code;
}

/* Of a sentence that others follow. */
static void trim(char *why)
{
	size_t n = strlen(why);

	while (n > 0 && strchr(". ", why[n - 1]) != NULL)
		why[--n] = '\0';
}

/* "The certificate is NOT trusted. ..." or what went wrong else. */
static void explain(const struct backing_redis_tls *tls, int code, char *why)
{
	gnutls_datum_t text = {NULL, 0};

	if (code == GNUTLS_E_CERTIFICATE_VERIFICATION_ERROR &&
	    gnutls_certificate_verification_status_print(
	    gnutls_session_get_verify_cert_status(tls->session),
	    GNUTLS_CRT_X509, &text, 0) >= 0)
		snprintf(why, BACKING_REDIS_TLS_WHY_MAX, "TLS: %s",
		    (const char *)text.data);
	else if (code == GNUTLS_E_FATAL_ALERT_RECEIVED)
		snprintf(why, BACKING_REDIS_TLS_WHY_MAX, "TLS: it refuses: %s",
		    gnutls_alert_get_name(gnutls_alert_get(tls->session)));
	else
		snprintf(why, BACKING_REDIS_TLS_WHY_MAX, "TLS: %s",
		    gnutls_strerror(code));
	gnutls_free(text.data);
	trim(why);
}

/* Whether a handshake fails so where nobody speaks TLS. */
static bool is_no_tls(int code)
{
	return code == GNUTLS_E_TIMEDOUT ||
	    code == GNUTLS_E_PREMATURE_TERMINATION ||
	    code == GNUTLS_E_UNEXPECTED_PACKET ||
	    code == GNUTLS_E_UNEXPECTED_PACKET_LENGTH ||
	    code == GNUTLS_E_UNSUPPORTED_VERSION_PACKET;
}

enum err backing_redis_tls_open(const struct backing_redis_url *url, int fd,
    unsigned milliseconds, struct backing_redis_tls **out,
    char why[static BACKING_REDIS_TLS_WHY_MAX])
{
	struct backing_redis_tls *tls = calloc(1, sizeof *tls);
	enum err err = ERR_MEMORY;
	int code;

	snprintf(why, BACKING_REDIS_TLS_WHY_MAX, "out of memory");
	if (tls != NULL) {
		tls->fd = fd;
		err = load(url, &tls->credentials, why);
	}
	if (err != ERR_OK) {
		free(tls);
		return ERR_UNAVAILABLE;
	}
	code = make_session(tls, url, milliseconds);
	while (code >= 0) {
		code = gnutls_handshake(tls->session);
		if (code == GNUTLS_E_SUCCESS) {
			*out = tls;
			return ERR_OK;
		}
		/* Warnings, and calls that were interrupted. */
		if (code != GNUTLS_E_AGAIN && gnutls_error_is_fatal(code) == 0)
			code = 0;
	}
	explain(tls, code, why);
	if (is_no_tls(code))
		strncat(why, " (does it speak TLS?)",
		    BACKING_REDIS_TLS_WHY_MAX - 1 - strlen(why));
	backing_redis_tls_close(tls);
	return ERR_UNAVAILABLE;
}

void backing_redis_tls_close(struct backing_redis_tls *tls)
{
	if (tls == NULL)
		return;
	if (tls->session != NULL)
		gnutls_deinit(tls->session);
	gnutls_certificate_free_credentials(tls->credentials);
	free(tls);
}

/* ---- bytes ---- */

/* The socket's limit on waiting. */
static double wait_seconds(const struct backing_redis_tls *tls, int which)
{
	struct timeval t = {0, 0};
	socklen_t size = sizeof t;

	getsockopt(tls->fd, SOL_SOCKET, which, &t, &size);
	return (double)t.tv_sec + 1e-6 * (double)t.tv_usec;
}

/*
 * Whether it is to be tried again; else errno and what failed are noted. AGAIN is
 * said where the socket's limit has passed, and, long before that, of a record
 * that had nothing for us: TLS 1.3's tickets.
 */
static bool goes_on(struct backing_redis_tls *tls, ssize_t code, double until)
{
	if (code == GNUTLS_E_INTERRUPTED || code == GNUTLS_E_REHANDSHAKE ||
	    code == GNUTLS_E_WARNING_ALERT_RECEIVED ||
	    (code == GNUTLS_E_AGAIN && clock_seconds() < until))
		return true;
	tls->code = (int)code;
	errno = code == GNUTLS_E_AGAIN ? EAGAIN : EPROTO;
	return false;
}

bool backing_redis_tls_send(struct backing_redis_tls *tls, const void *data,
    size_t length)
{
	const double until = clock_seconds() + wait_seconds(tls, SO_SNDTIMEO);
	const char *at = data;

	while (length > 0) {
		ssize_t n = gnutls_record_send(tls->session, at, length);

		if (n < 0 && !goes_on(tls, n, until))
			return false;
		if (n > 0) {
			at += n;
			length -= (size_t)n;
		}
	}
	return true;
}

ssize_t backing_redis_tls_receive(struct backing_redis_tls *tls, void *out,
    size_t size)
{
	const double until = clock_seconds() + wait_seconds(tls, SO_RCVTIMEO);
	ssize_t n;

	do
		n = gnutls_record_recv(tls->session, out, size);
	while (n < 0 && goes_on(tls, n, until));
	if (n == 0) {
		tls->code = 0;
		errno = ECONNRESET; /* whatever an earlier record has left */
	}
	return n < 0 ? -1 : n;
}

const char *backing_redis_tls_why(struct backing_redis_tls *tls)
{
	if (tls->code == 0)
		return "Server closed the connection";
	/* By TLS 1.3 it says only now that it wants another certificate. */
	explain(tls, tls->code, tls->why);
	return tls->why;
}

/* What may have come without having been asked for is a ticket for a later
 * session, or the end. */
bool backing_redis_tls_is_hung_up(struct backing_redis_tls *tls)
{
	const int flags = fcntl(tls->fd, F_GETFL);
	struct pollfd look = {.fd = tls->fd, .events = POLLIN};
	ssize_t n = GNUTLS_E_AGAIN;
	char byte;

	if (flags < 0 || fcntl(tls->fd, F_SETFL, flags | O_NONBLOCK) != 0)
		return true;
	while (n == GNUTLS_E_AGAIN && poll(&look, 1, 0) > 0)
		n = gnutls_record_recv(tls->session, &byte, 1);
	if (fcntl(tls->fd, F_SETFL, flags) != 0)
		return true;
	return n != GNUTLS_E_AGAIN;
}
