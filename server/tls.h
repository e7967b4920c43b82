/*
 * Certificate and key for HTTPS (--tls-cert, --tls-key), read anew on SIGHUP.
 * Handshakes in flight keep those that they began with: a pair lives as long as
 * it is the present one or a connection has taken it.
 *
 * Threads: tls_reload may be called while others take and release.
 */
#ifndef SERVER_TLS_H
#define SERVER_TLS_H

#include "core/err.h"

struct gnutls_pcert_st;
struct gnutls_privkey_st;
struct tls;
struct tls_pair;

/* For gnutls_priority_init: TLS 1.2 and 1.3; keys by ECDHE only, so that a key
 * that gets known later opens nothing recorded; AEAD ciphers only; first the
 * group that clients guess, whom another one costs a round trip. */
#define TLS_PRIORITIES "SECURE128:-VERS-ALL:+VERS-TLS1.3:+VERS-TLS1.2:" \
    "-KX-ALL:+ECDHE-ECDSA:+ECDHE-RSA:-MAC-ALL:+AEAD:-GROUP-ALL:" \
    "+GROUP-X25519:+GROUP-SECP256R1:+GROUP-SECP384R1:+GROUP-SECP521R1:" \
    "%SERVER_PRECEDENCE"

/*
 * Reads both PEM files: a certificate with those that vouch for it behind it,
 * and its key, without a password. ERR_IO, ERR_INVALID (no certificate, no key,
 * or they do not belong together: the log says which), ERR_MEMORY. A key that
 * others may read, and a certificate that is out of date, are logged as
 * warnings.
 */
enum err tls_create(const char *cert, const char *key, struct tls **out);

/* Reads them anew; what is wrong is logged, and changes nothing. */
enum err tls_reload(struct tls *tls);

/* The present pair, for tls_release. */
struct tls_pair *tls_take(struct tls *tls);

/* NULL does nothing. */
void tls_release(struct tls_pair *pair);

/* What GnuTLS asks for in a handshake; valid until tls_release. */
void tls_show(const struct tls_pair *pair, struct gnutls_pcert_st **chain,
    unsigned *length, struct gnutls_privkey_st **key);

/* Once nobody serves any more. NULL does nothing. */
void tls_free(struct tls *tls);

#endif
