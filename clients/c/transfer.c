#include "clients/c/transfer.h"

#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <time.h>

#include <cjson/cJSON.h>

/* Seconds between two questions how far the work is, and between two looks at
 * whether it has been given up. */
#define ASK_SECONDS 0.2
#define LOOK_MS 50

/* What one transfer_do works on. */
struct work {
	struct transfer *t;
	const struct transfer_request *request;
	enum blobfield_outcome failed; /* of the answer's way to its place */
	struct blobfield_bytes told;   /* /v1/progress's answer */
	char stage[32];
	double done;
	char token[TRANSFER_TOKEN_MAX];
	struct curl_slist *lines;      /* of headers, of the questions; or NULL */
	bool is_asking;                /* side is in multi */
	double asked;                  /* when */
	double heard;                  /* when the last byte came */
};

static double now(void)
{
	struct timespec time;

	clock_gettime(CLOCK_MONOTONIC, &time);
	return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

/* Appends; false: out of memory. One byte more than size is there. */
static bool append(struct blobfield_bytes *bytes, const char *data, size_t n)
{
	/* Doubled whenever size passes a power of two. */
	const size_t had = bytes->size, needed = had + n + 1;
	size_t room = 4096, old = 4096;

	while (old < had + 1)
		old *= 2;
	while (room < needed)
		room *= 2;
	if (bytes->data == NULL || room > old) {
		unsigned char *larger = realloc(bytes->data, room);

		if (larger == NULL)
			return false;
		bytes->data = larger;
	}
	memcpy(bytes->data + had, data, n);
	bytes->size += n;
	bytes->data[bytes->size] = '\0';
	return true;
}

static enum blobfield_outcome place(struct work *w, const char *data, size_t n)
{
	struct transfer *t = w->t;
	const struct transfer_request *r = w->request;
	long status = 0;

	curl_easy_getinfo(t->main, CURLINFO_RESPONSE_CODE, &status);
	if (status < 400 && r->take != NULL)
		return r->take(r->ctx, data, n);
	if (status >= 400 || (r->into == NULL && r->file == NULL))
		return append(&t->bytes, data, n) ? BLOBFIELD_OK :
		    BLOBFIELD_MEMORY;
	if (r->file != NULL) {
		if (fwrite(data, 1, n, r->file) != n)
			return BLOBFIELD_FILE;
	} else {
		if (n > r->into_size - t->arrived)
			return BLOBFIELD_STRANGE;
		memcpy((char *)r->into + t->arrived, data, n);
	}
	t->arrived += n;
	return BLOBFIELD_OK;
}

static size_t take(char *data, size_t size, size_t count, void *ctx)
{
	struct work *w = ctx;

	w->heard = now();
	w->failed = place(w, data, size * count);
	return w->failed == BLOBFIELD_OK ? size * count : 0;
}

static size_t take_told(char *data, size_t size, size_t count, void *ctx)
{
	struct work *w = ctx;

	return append(&w->told, data, size * count) ? size * count : 0;
}

static bool set_up(CURL *curl)
{
	/* The daemon is near; a proxy that the environment names is not. */
	return curl_easy_setopt(curl, CURLOPT_NOPROXY, "*") == CURLE_OK &&
	    curl_easy_setopt(curl, CURLOPT_PROTOCOLS_STR, "http,https") ==
	    CURLE_OK &&
	    curl_easy_setopt(curl, CURLOPT_NOSIGNAL, 1L) == CURLE_OK &&
	    curl_easy_setopt(curl, CURLOPT_CONNECTTIMEOUT, 10L) == CURLE_OK;
}

bool transfer_init(struct transfer *t, const char *url)
{
	size_t length = strlen(url);

	memset(t, 0, sizeof *t);
	while (length > 0 && url[length - 1] == '/')
		length--;
	if (length >= sizeof t->url ||
	    curl_global_init(CURL_GLOBAL_DEFAULT) != CURLE_OK)
		return false;
	memcpy(t->url, url, length);
	t->multi = curl_multi_init();
	t->main = curl_easy_init();
	t->side = curl_easy_init();
	if (t->multi != NULL && t->main != NULL && t->side != NULL &&
	    set_up(t->main) && set_up(t->side)) {
		curl_easy_getinfo(t->main, CURLINFO_CAINFO, &t->ca_file);
		curl_easy_getinfo(t->main, CURLINFO_CAPATH, &t->ca_folder);
		return true;
	}
	transfer_fini(t);
	return false;
}

enum blobfield_outcome transfer_set_ca(struct transfer *t, const char *path)
{
	CURL *const both[] = {t->main, t->side};

	for (int i = 0; i < 2; i++) {
		const char *folder = NULL, *file = path;

		if (path == NULL) {
			/* What libcurl has found out when it was built. */
			file = t->ca_file;
			folder = t->ca_folder;
		}
		if (curl_easy_setopt(both[i], CURLOPT_CAINFO, file) !=
		    CURLE_OK)
			return BLOBFIELD_MEMORY;
		/* Not every TLS library knows folders. */
		curl_easy_setopt(both[i], CURLOPT_CAPATH, folder);
	}
	return BLOBFIELD_OK;
}

void transfer_fini(struct transfer *t)
{
	curl_easy_cleanup(t->main);
	curl_easy_cleanup(t->side);
	curl_multi_cleanup(t->multi);
	blobfield_bytes_fini(&t->bytes);
	curl_global_cleanup();
}

/* A word that no other client asks by. */
static void make_token(char token[static TRANSFER_TOKEN_MAX])
{
	unsigned char random[12] = {0};
	char *at = token;

	if (getrandom(random, sizeof random, 0) < 0)
		memcpy(random, &(double){now()}, sizeof(double));
	at += sprintf(at, "c-");
	for (size_t i = 0; i < sizeof random; i++)
		at += sprintf(at, "%02x", random[i]);
}

static char *make_url(struct work *w)
{
	const struct transfer *t = w->t;
	const struct transfer_request *r = w->request;
	const size_t size = strlen(t->url) + strlen(r->path) + 128;
	char *url = malloc(size);
	int length;

	if (url == NULL)
		return NULL;
	length = snprintf(url, size, "%s%s", t->url, r->path);
	if (w->token[0] != '\0')
		length += snprintf(url + length, size - (size_t)length,
		    "%cprogress=%s", strchr(url, '?') ? '&' : '?', w->token);
	if (r->is_long && t->deadline > 0.0)
		snprintf(url + length, size - (size_t)length,
		    "%cdeadline=%.9g", strchr(url, '?') ? '&' : '?',
		    t->deadline);
	return url;
}

/* NULL: out of memory. */
static struct curl_slist *add(struct curl_slist *list, const char *line)
{
	struct curl_slist *longer;

	if (list == NULL)
		return NULL;
	longer = curl_slist_append(list, line);
	if (longer == NULL)
		curl_slist_free_all(list);
	return longer;
}

static struct curl_slist *add_line(struct curl_slist *list, const char *name,
    const char *value)
{
	char line[320];

	snprintf(line, sizeof line, "%s: %s", name, value);
	return add(list, line);
}

static struct curl_slist *make_lines(const struct transfer *t,
    const struct transfer_request *r)
{
	/* libcurl would wait a second for 100 Continue. */
	struct curl_slist *list = curl_slist_append(NULL, "Expect:");

	list = add_line(list, "Accept", r->accept != NULL ? r->accept : "*/*");
	if (r->type != NULL)
		list = add_line(list, "Content-Type", r->type);
	if (r->line != NULL)
		list = add(list, r->line);
	if (t->authorization[0] != '\0')
		list = add_line(list, "Authorization", t->authorization);
	return list;
}

static void set_body(CURL *curl, const struct transfer_request *r)
{
	const bool has_body = r->body != NULL;

	curl_easy_setopt(curl, CURLOPT_HTTPGET, 1L);
	if (has_body || strcmp(r->method, "POST") == 0) {
		curl_easy_setopt(curl, CURLOPT_POST, 1L);
		curl_easy_setopt(curl, CURLOPT_POSTFIELDS,
		    has_body ? r->body : "");
		curl_easy_setopt(curl, CURLOPT_POSTFIELDSIZE_LARGE,
		    (curl_off_t)(has_body ? r->size : 0));
	}
	curl_easy_setopt(curl, CURLOPT_CUSTOMREQUEST, r->method);
}

/* {"stage": "cells", "done": 0.42}, or nothing that matters. */
static void read_told(struct work *w)
{
	cJSON *json = cJSON_Parse((const char *)w->told.data);
	const cJSON *stage = cJSON_GetObjectItem(json, "stage");
	const cJSON *done = cJSON_GetObjectItem(json, "done");

	if (cJSON_IsString(stage) && cJSON_IsNumber(done)) {
		snprintf(w->stage, sizeof w->stage, "%s", stage->valuestring);
		w->done = done->valuedouble;
	}
	cJSON_Delete(json);
}

static void ask(struct work *w)
{
	struct transfer *t = w->t;
	char url[sizeof t->url + TRANSFER_TOKEN_MAX + 16];

	if (w->token[0] == '\0' || w->is_asking ||
	    now() - w->asked < ASK_SECONDS)
		return;
	snprintf(url, sizeof url, "%s/v1/progress/%s", t->url, w->token);
	blobfield_bytes_fini(&w->told);
	curl_easy_setopt(t->side, CURLOPT_URL, url);
	curl_easy_setopt(t->side, CURLOPT_HTTPHEADER, w->lines);
	curl_easy_setopt(t->side, CURLOPT_WRITEFUNCTION, take_told);
	curl_easy_setopt(t->side, CURLOPT_WRITEDATA, w);
	w->is_asking = curl_multi_add_handle(t->multi, t->side) == CURLM_OK;
	w->asked = now();
}

/* Whether the main transfer is over, *result then being how. */
static bool is_over(struct work *w, CURLcode *result)
{
	struct transfer *t = w->t;
	CURLMsg *message;
	int left;

	while ((message = curl_multi_info_read(t->multi, &left)) != NULL) {
		long status = 0;

		if (message->msg != CURLMSG_DONE)
			continue;
		if (message->easy_handle == t->main) {
			*result = message->data.result;
			return true;
		}
		curl_easy_getinfo(t->side, CURLINFO_RESPONSE_CODE, &status);
		if (message->data.result == CURLE_OK && status == 200)
			read_told(w);
		curl_multi_remove_handle(t->multi, t->side);
		w->is_asking = false;
	}
	return false;
}

static bool is_given_up(struct work *w)
{
	struct transfer *t = w->t;

	if (t->progress != NULL &&
	    t->progress(t->ctx, w->stage, w->done) != 0)
		return true;
	return atomic_load(&t->cancelled);
}

static bool is_silent(const struct work *w)
{
	return w->request->silence > 0.0 &&
	    now() - w->heard > w->request->silence;
}

/* Both transfers, until the main one is over or given up. */
static enum blobfield_outcome drive(struct work *w, CURLcode *result)
{
	struct transfer *t = w->t;
	int running;

	while (curl_multi_perform(t->multi, &running) == CURLM_OK) {
		if (is_over(w, result))
			return BLOBFIELD_OK;
		if (is_given_up(w))
			return BLOBFIELD_CANCELLED;
		if (is_silent(w)) {
			snprintf(t->reason, sizeof t->reason, "nothing comes "
			    "any more");
			return BLOBFIELD_UNREACHABLE;
		}
		ask(w);
		if (curl_multi_poll(t->multi, NULL, 0, LOOK_MS, NULL) !=
		    CURLM_OK)
			break;
	}
	return BLOBFIELD_MEMORY;
}

static enum blobfield_outcome outcome_of(struct work *w, CURLcode result)
{
	struct transfer *t = w->t;

	if (w->failed != BLOBFIELD_OK)
		return w->failed;
	if (result == CURLE_OUT_OF_MEMORY)
		return BLOBFIELD_MEMORY;
	if (result != CURLE_OK) {
		if (t->reason[0] == '\0')
			snprintf(t->reason, sizeof t->reason, "%s",
			    curl_easy_strerror(result));
		return BLOBFIELD_UNREACHABLE;
	}
	curl_easy_getinfo(t->main, CURLINFO_RESPONSE_CODE, &t->status);
	if (t->status < 400 && w->request->into != NULL &&
	    t->arrived != w->request->into_size)
		return BLOBFIELD_STRANGE;
	return BLOBFIELD_OK;
}

static enum blobfield_outcome run(struct work *w)
{
	struct transfer *t = w->t;
	enum blobfield_outcome outcome;
	CURLcode result = CURLE_OK;

	if (curl_multi_add_handle(t->multi, t->main) != CURLM_OK)
		return BLOBFIELD_MEMORY;
	outcome = drive(w, &result);
	curl_multi_remove_handle(t->multi, t->main);
	if (w->is_asking)
		curl_multi_remove_handle(t->multi, t->side);
	return outcome != BLOBFIELD_OK ? outcome : outcome_of(w, result);
}

enum blobfield_outcome transfer_do(struct transfer *t,
    const struct transfer_request *request)
{
	struct work w = {.t = t, .request = request, .asked = now(),
	    .heard = now()};
	struct curl_slist *lines = make_lines(t, request);
	enum blobfield_outcome outcome = BLOBFIELD_MEMORY;
	char *url;

	blobfield_bytes_fini(&t->bytes);
	t->status = 0;
	t->arrived = 0;
	t->reason[0] = '\0';
	if (request->is_long && t->progress != NULL)
		make_token(w.token);
	url = make_url(&w);
	w.lines = t->authorization[0] != '\0' ? add_line(
	    curl_slist_append(NULL, "Accept: application/json"),
	    "Authorization", t->authorization) : NULL;
	if (url != NULL && lines != NULL) {
		set_body(t->main, request);
		curl_easy_setopt(t->main, CURLOPT_URL, url);
		curl_easy_setopt(t->main, CURLOPT_HTTPHEADER, lines);
		curl_easy_setopt(t->main, CURLOPT_ERRORBUFFER, t->reason);
		curl_easy_setopt(t->main, CURLOPT_WRITEFUNCTION, take);
		curl_easy_setopt(t->main, CURLOPT_WRITEDATA, &w);
		outcome = run(&w);
		curl_easy_setopt(t->main, CURLOPT_HTTPHEADER, NULL);
	}
	atomic_store(&t->cancelled, false);
	curl_easy_setopt(t->side, CURLOPT_HTTPHEADER, NULL);
	curl_slist_free_all(w.lines);
	curl_slist_free_all(lines);
	blobfield_bytes_fini(&w.told);
	free(url);
	return outcome;
}

enum blobfield_outcome transfer_wait(struct transfer *t, double seconds)
{
	const double until = now() + seconds;

	while (now() < until) {
		if ((t->progress != NULL && t->progress(t->ctx, "", 0.0) != 0)
		    || atomic_load(&t->cancelled)) {
			atomic_store(&t->cancelled, false);
			return BLOBFIELD_CANCELLED;
		}
		curl_multi_poll(t->multi, NULL, 0, LOOK_MS, NULL);
	}
	return BLOBFIELD_OK;
}
