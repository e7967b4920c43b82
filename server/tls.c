#include "server/tls.h"

#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>

#include <gnutls/abstract.h>
#include <gnutls/gnutls.h>
#include <gnutls/x509.h>

#include "server/log.h"

#define CHAIN_MAX 16
#define ID_MAX 64

struct tls_pair {
	atomic_size_t holders;
	gnutls_pcert_st chain[CHAIN_MAX];
	unsigned length;
	gnutls_privkey_t key;
};

struct tls {
	char *cert_path, *key_path;
	pthread_mutex_t lock; /* guards present */
	struct tls_pair *present;
};

/* ---- one pair ---- */

static enum err fail(const char *path, const char *what)
{
	log_write(LOG_ERROR, "%s: %s", path, what);
	return ERR_INVALID;
}

static enum err load(const char *path, gnutls_datum_t *out)
{
	int code = gnutls_load_file(path, out);

	if (code == GNUTLS_E_SUCCESS)
		return ERR_OK;
	log_write(LOG_ERROR, "%s: cannot be read: %s", path,
	    errno != 0 ? strerror(errno) : gnutls_strerror(code));
	return ERR_IO;
}

/* Not after, not before. */
static void check_dates(const char *path, const gnutls_datum_t *text)
{
	gnutls_x509_crt_t cert;
	time_t now = time(NULL);

	if (gnutls_x509_crt_init(&cert) != GNUTLS_E_SUCCESS)
		return;
	if (gnutls_x509_crt_import(cert, text, GNUTLS_X509_FMT_PEM) ==
	    GNUTLS_E_SUCCESS) {
		if (gnutls_x509_crt_get_expiration_time(cert) < now)
			log_write(LOG_WARNING, "%s: the certificate has "
			    "expired", path);
		else if (gnutls_x509_crt_get_activation_time(cert) > now)
			log_write(LOG_WARNING, "%s: the certificate is not "
			    "valid yet", path);
	}
	gnutls_x509_crt_deinit(cert);
}

static enum err read_chain(const char *path, struct tls_pair *pair)
{
	unsigned length = CHAIN_MAX;
	gnutls_datum_t text;
	enum err err = load(path, &text);
	int code;

	if (err != ERR_OK)
		return err;
	code = gnutls_pcert_list_import_x509_raw(pair->chain, &length, &text,
	    GNUTLS_X509_FMT_PEM, GNUTLS_X509_CRT_LIST_FAIL_IF_UNSORTED);
	if (code == GNUTLS_E_SUCCESS) {
		pair->length = length;
		check_dates(path, &text);
	} else {
		err = fail(path, code == GNUTLS_E_NO_CERTIFICATE_FOUND ||
		    code == GNUTLS_E_BASE64_UNEXPECTED_HEADER_ERROR ?
		    "there is no certificate in PEM form" :
		    code == GNUTLS_E_SHORT_MEMORY_BUFFER ?
		    "there are more than 16 certificates" :
		    code == GNUTLS_E_CERTIFICATE_LIST_UNSORTED ?
		    "each certificate must be vouched for by the next one" :
		    gnutls_strerror(code));
	}
	gnutls_free(text.data);
	return err;
}

static void check_mode(const char *path)
{
	struct stat info;

	if (stat(path, &info) == 0 && (info.st_mode & (S_IROTH | S_IWOTH)))
		log_write(LOG_WARNING, "%s: others than its owner may read or "
		    "write this key: chmod o= would mend that", path);
}

static enum err read_key(const char *path, struct tls_pair *pair)
{
	gnutls_datum_t text;
	enum err err = load(path, &text);
	int code;

	if (err != ERR_OK)
		return err;
	check_mode(path);
	code = gnutls_privkey_init(&pair->key);
	if (code == GNUTLS_E_SUCCESS)
		code = gnutls_privkey_import_x509_raw(pair->key, &text,
		    GNUTLS_X509_FMT_PEM, NULL, 0);
	if (code != GNUTLS_E_SUCCESS)
		err = fail(path, code == GNUTLS_E_DECRYPTION_FAILED ?
		    "the key needs a password, for which nobody can be asked" :
		    "there is no private key in PEM form");
	gnutls_memset(text.data, 0, text.size);
	gnutls_free(text.data);
	return err;
}

static bool read_id(gnutls_pubkey_t pubkey, unsigned char id[static ID_MAX])
{
	size_t size = ID_MAX;

	memset(id, 0, ID_MAX);
	return gnutls_pubkey_get_key_id(pubkey, 0, id, &size) ==
	    GNUTLS_E_SUCCESS;
}

/* Whether the first certificate is of this key. */
static bool belong_together(const struct tls_pair *pair)
{
	unsigned char a[ID_MAX], b[ID_MAX];
	gnutls_pubkey_t pubkey;
	bool same;

	if (gnutls_pubkey_init(&pubkey) != GNUTLS_E_SUCCESS)
		return false;
	same = gnutls_pubkey_import_privkey(pubkey, pair->key, 0, 0) ==
	    GNUTLS_E_SUCCESS && read_id(pubkey, a) &&
	    read_id(pair->chain[0].pubkey, b) && memcmp(a, b, ID_MAX) == 0;
	gnutls_pubkey_deinit(pubkey);
	return same;
}

static void free_pair(struct tls_pair *pair)
{
	for (unsigned i = 0; i < pair->length; i++)
		gnutls_pcert_deinit(&pair->chain[i]);
	if (pair->key != NULL)
		gnutls_privkey_deinit(pair->key);
	free(pair);
}

static enum err read_pair(const struct tls *tls, struct tls_pair **out)
{
	struct tls_pair *pair = calloc(1, sizeof *pair);
	enum err err;

	if (pair == NULL)
		return ERR_MEMORY;
	atomic_init(&pair->holders, 1);
	err = read_chain(tls->cert_path, pair);
	if (err == ERR_OK)
		err = read_key(tls->key_path, pair);
	if (err == ERR_OK && !belong_together(pair)) {
		log_write(LOG_ERROR, "%s and %s do not belong together: the "
		    "certificate is of another key", tls->cert_path,
		    tls->key_path);
		err = ERR_INVALID;
	}
	if (err == ERR_OK)
		*out = pair;
	else
		free_pair(pair);
	return err;
}

/* ---- the present one ---- */

enum err tls_create(const char *cert, const char *key, struct tls **out)
{
	struct tls *tls;
	enum err err = ERR_MEMORY;

	if (key[0] == '\0') {
		log_write(LOG_ERROR, "--tls-cert is there, but no --tls-key: "
		    "HTTPS needs both");
		return ERR_INVALID;
	}
	tls = calloc(1, sizeof *tls);
	if (tls == NULL)
		return ERR_MEMORY;
	pthread_mutex_init(&tls->lock, NULL);
	tls->cert_path = strdup(cert);
	tls->key_path = strdup(key);
	if (tls->cert_path != NULL && tls->key_path != NULL)
		err = read_pair(tls, &tls->present);
	if (err == ERR_OK)
		*out = tls;
	else
		tls_free(tls);
	return err;
}

enum err tls_reload(struct tls *tls)
{
	struct tls_pair *pair, *old;
	enum err err = read_pair(tls, &pair);

	if (err != ERR_OK) {
		log_write(LOG_ERROR, "the certificate stays as it was");
		return err;
	}
	pthread_mutex_lock(&tls->lock);
	old = tls->present;
	tls->present = pair;
	pthread_mutex_unlock(&tls->lock);
	tls_release(old);
	log_write(LOG_INFO, "certificate read anew");
	return ERR_OK;
}

struct tls_pair *tls_take(struct tls *tls)
{
	struct tls_pair *pair;

	pthread_mutex_lock(&tls->lock);
	pair = tls->present;
	atomic_fetch_add(&pair->holders, 1);
	pthread_mutex_unlock(&tls->lock);
	return pair;
}

void tls_release(struct tls_pair *pair)
{
	if (pair != NULL && atomic_fetch_sub(&pair->holders, 1) == 1)
		free_pair(pair);
}

void tls_show(const struct tls_pair *pair, struct gnutls_pcert_st **chain,
    unsigned *length, struct gnutls_privkey_st **key)
{
	/* GnuTLS wants them unqualified but only reads them. */
	*chain = (gnutls_pcert_st *)(size_t)pair->chain;
	*length = pair->length;
	*key = pair->key;
}

void tls_free(struct tls *tls)
{
	if (tls == NULL)
		return;
	tls_release(tls->present);
	pthread_mutex_destroy(&tls->lock);
	free(tls->cert_path);
	free(tls->key_path);
	free(tls);
}
