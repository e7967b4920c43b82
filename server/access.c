/*
 * An exchange that has a token holds the table that the token is in: a reload
 * puts another table in its place, and the last that holds the old one frees
 * it.
 */
#include "server/access.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <microhttpd.h>
#include <netdb.h>
#include <netinet/in.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cjson/cJSON.h>

#include "core/tape.h"
#include "proto/fault.h"
#include "server/clock.h"
#include "server/config.h"
#include "server/cors.h"
#include "server/exchange.h"
#include "server/host.h"
#include "server/http_accept.h"
#include "server/log.h"
#include "server/program.h"
#include "server/routes.h"
#include "server/server.h"
#include "server/tables.h"
#include "server/token.h"

#define FILE_BYTES_MAX ((size_t)4 << 20)
#define REALM "Bearer realm=\"blobfield\""
#define RETRY_SECONDS_MAX 1e9

/* Of a secret: 160 bits, as many as its 32 letters of 5 bits say. */
#define SECRET_BYTES 20
#define SECRET_LETTERS 32

struct access {
	const char *file; /* "": there is none */
	pthread_mutex_t lock; /* guards: */
	struct token_table *table; /* NULL: everybody may do everything */
	atomic_uint reloads;
};

/* ---- the file ---- */

/* Whether what is open at fd may be believed; says why not. */
static bool check_file(const char *file, int fd)
{
	struct stat stat;

	if (fstat(fd, &stat) != 0 || !S_ISREG(stat.st_mode)) {
		log_write(LOG_ERROR, "tokens: %s is not a file", file);
		return false;
	}
	if (stat.st_uid != geteuid() && stat.st_uid != 0) {
		log_write(LOG_ERROR, "tokens: %s belongs to another user (%ld)"
		    ": it must be this one's, or root's", file,
		    (long)stat.st_uid);
		return false;
	}
	if (stat.st_mode & (S_IWGRP | S_IWOTH)) {
		log_write(LOG_ERROR, "tokens: others may write %s: chmod 600 "
		    "it", file);
		return false;
	}
	if (stat.st_mode & S_IROTH)
		log_write(LOG_WARNING, "tokens: others may read %s, names, "
		    "roles and hashes: chmod 600 it", file);
	return true;
}

/* All of fd, at most FILE_BYTES_MAX, for free; NULL with errno. */
static char *read_all(int fd, size_t *length)
{
	char *text = malloc(FILE_BYTES_MAX + 1);
	size_t n = 0;
	ssize_t got = 1;

	while (text != NULL && got > 0 && n <= FILE_BYTES_MAX) {
		got = read(fd, text + n, FILE_BYTES_MAX + 1 - n);
		if (got > 0)
			n += (size_t)got;
		else if (got < 0 && errno == EINTR)
			got = 1;
	}
	if (text != NULL && got >= 0 && n <= FILE_BYTES_MAX) {
		*length = n;
		return text;
	}
	if (n > FILE_BYTES_MAX)
		errno = EFBIG;
	free(text);
	return NULL;
}

static void log_faults(const char *file, const struct faults *faults)
{
	for (size_t i = 0; i < faults->count && i < FAULT_MAX; i++) {
		const struct fault *f = &faults->list[i];

		log_write(LOG_ERROR, "tokens: %s: %s%s%s", file, f->pointer,
		    f->pointer[0] != '\0' ? ": " : "", f->detail);
	}
}

static enum err read_table(const char *file, const struct token_table *old,
    struct token_table **out)
{
	struct faults faults = {0};
	const int fd = open(file, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
	char *text = NULL;
	size_t length;
	enum err err = ERR_IO;

	if (fd < 0) {
		log_write(LOG_ERROR, "tokens: %s: %s", file, strerror(errno));
		return ERR_IO;
	}
	if (check_file(file, fd)) {
		text = read_all(fd, &length);
		if (text == NULL)
			log_write(LOG_ERROR, "tokens: %s: %s", file,
			    strerror(errno));
		else
			err = token_table_read(text, length, old, out,
			    &faults);
		if (err != ERR_OK && text != NULL && (length == 0 ||
		    text[0] != '{'))
			log_write(LOG_ERROR, "tokens: %s must be of the form "
			    "{\"tokens\": [ENTRY, ...]}, with --make-token's "
			    "second line for each ENTRY", file);
	}
	log_faults(file, &faults);
	if (err == ERR_OK && (*out)->count == 0)
		log_write(LOG_WARNING, "tokens: %s has no entry: nobody may do "
		    "anything. Make one with --make-token NAME:ROLE", file);
	free(text);
	close(fd);
	return err;
}

/* ---- life ---- */

enum err access_create(const struct config *config, struct access **out)
{
	struct access *a;
	enum err err = ERR_OK;

	if (!cors_check(config->cors) ||
	    !host_names_are_valid(config->hosts))
		return ERR_INVALID;
	a = calloc(1, sizeof *a);
	if (a == NULL)
		return ERR_MEMORY;
	a->file = config->tokens;
	pthread_mutex_init(&a->lock, NULL);
	if (a->file[0] != '\0')
		err = read_table(a->file, NULL, &a->table);
	if (err != ERR_OK) {
		access_free(a);
		return err;
	}
	*out = a;
	return ERR_OK;
}

void access_free(struct access *a)
{
	if (a == NULL)
		return;
	token_table_release(a->table);
	pthread_mutex_destroy(&a->lock);
	free(a);
}

enum err access_reload(struct access *a)
{
	struct token_table *table, *old;
	enum err err;

	if (a->file[0] == '\0')
		return ERR_OK;
	/* Only this function, on one thread, ever changes a->table. */
	err = read_table(a->file, a->table, &table);
	if (err != ERR_OK) {
		log_write(LOG_ERROR, "tokens: going on with those from "
		    "before");
		return err;
	}
	pthread_mutex_lock(&a->lock);
	old = a->table;
	a->table = table;
	pthread_mutex_unlock(&a->lock);
	token_table_release(old);
	atomic_fetch_add(&a->reloads, 1);
	log_write(LOG_INFO, "tokens: %zu of them", table->count);
	return ERR_OK;
}

bool access_is_closed(const struct access *a)
{
	return a->file[0] != '\0';
}

static struct token_table *hold_table(struct access *a)
{
	struct token_table *table;

	pthread_mutex_lock(&a->lock);
	table = token_table_hold(a->table);
	pthread_mutex_unlock(&a->lock);
	return table;
}

/* ---- who asks ---- */

static bool is_loopback(const struct sockaddr_storage *address)
{
	const struct sockaddr_in *v4 = (const void *)address;
	const struct sockaddr_in6 *v6 = (const void *)address;

	switch (address->ss_family) {
	case AF_UNIX:
		return true;
	case AF_INET:
		return ntohl(v4->sin_addr.s_addr) >> 24 == 127;
	case AF_INET6:
		return IN6_IS_ADDR_LOOPBACK(&v6->sin6_addr) ||
		    (IN6_IS_ADDR_V4MAPPED(&v6->sin6_addr) &&
		    v6->sin6_addr.s6_addr[12] == 127);
	default:
		return false;
	}
}

/* 401, as RFC 6750, section 3 has it: why is "" if no token was sent. */
static bool refuse_stranger(struct exchange *x, const char *why,
    const char *error)
{
	char challenge[128];

	exchange_reply_problem(x, PROBLEM_UNAUTHORIZED, NULL,
	    "%s Send 'Authorization: Bearer TOKEN' with a token of the role "
	    "'%s' or more.", why, role_name(x->route->role));
	snprintf(challenge, sizeof challenge, REALM "%s%s%s",
	    error[0] != '\0' ? ", error=\"" : "", error,
	    error[0] != '\0' ? "\"" : "");
	exchange_add_header(x, "WWW-Authenticate", challenge);
	return false;
}

/* The secret of a header "Bearer SECRET", or NULL. */
static const char *find_secret(const char *header)
{
	static const char scheme[] = "Bearer";
	const size_t n = sizeof scheme - 1;
	const char *secret;

	if (strncasecmp(header, scheme, n) != 0 || header[n] != ' ')
		return NULL;
	secret = header + n + strspn(header + n, " ");
	return *secret != '\0' && strpbrk(secret, " \t,") == NULL ? secret :
	    NULL;
}

/* Where x comes from, of IPv6 the /64, else zeros; whether that is another
 * machine. */
static bool find_address(const struct exchange *x,
    uint8_t out[static TOKEN_ADDRESS_BYTES])
{
	struct sockaddr_storage storage = {0};
	struct sockaddr_in *v4 = (void *)&storage;
	struct sockaddr_in6 *v6 = (void *)&storage;
	char text[sizeof x->peer];
	struct accept_key key = {{0}};
	bool is_known = true;

	memcpy(text, x->peer, sizeof text);
	text[strcspn(text, "%")] = '\0'; /* of a link's scope */
	if (inet_pton(AF_INET, text, &v4->sin_addr) == 1)
		storage.ss_family = AF_INET;
	else if (inet_pton(AF_INET6, text, &v6->sin6_addr) == 1)
		storage.ss_family = AF_INET6;
	else
		is_known = false;
	if (is_known)
		accept_key_of((struct sockaddr *)&storage, &key);
	memcpy(out, key.bytes, sizeof key.bytes);
	return is_known && !is_loopback(&storage);
}

/* x->token, which then holds table; false: answered. */
static bool identify(struct exchange *x, struct token_table *table)
{
	const char *header = exchange_header(x, "Authorization");
	const char *secret;

	if (header == NULL) {
		uint8_t address[TOKEN_ADDRESS_BYTES];

		find_address(x, address);
		x->token = token_guest(table, address);
		return x->token != NULL || refuse_stranger(x,
		    "This server asks for a token.", "");
	}
	secret = find_secret(header);
	if (secret == NULL)
		return refuse_stranger(x, "The header 'Authorization' is not "
		    "'Bearer' and one token.", "invalid_request");
	x->token = token_find(table, secret, strlen(secret));
	return x->token != NULL || refuse_stranger(x,
	    "The token is not known here.", "invalid_token");
}

static bool check_role(struct exchange *x)
{
	const enum role needed = x->route->role;
	char challenge[128];

	if (x->token->role >= needed)
		return true;
	if (token_is_anonymous(x->token))
		return refuse_stranger(x, "This needs a token.", "");
	exchange_reply_problem(x, PROBLEM_FORBIDDEN, NULL,
	    "The token '%s' has the role '%s'; this needs '%s'.",
	    x->token->name, role_name(x->token->role), role_name(needed));
	snprintf(challenge, sizeof challenge, REALM
	    ", error=\"insufficient_scope\", scope=\"%s\"", role_name(needed));
	exchange_add_header(x, "WWW-Authenticate", challenge);
	return false;
}

/* ---- limits ---- */

/* 429, to be tried again in so many seconds. */
static bool refuse_rate(struct exchange *x, enum token_rate which, double wait)
{
	const double seconds = fmin(ceil(wait), RETRY_SECONDS_MAX);
	const char *whose = token_is_anonymous(x->token) ?
	    "Requests of one address without a token," : "The token";
	char text[24];

	exchange_reply_problem(x, PROBLEM_TOO_MANY, NULL,
	    "%s '%s' may take %s %.15g; the next request can come in %.0f s.",
	    whose, x->token->name, token_rate_name(which),
	    x->token->rates[which], seconds);
	if (x->response == NULL)
		return false;
	/* Instead of the kind's own. */
	snprintf(text, sizeof text, "%d",
	    problem_kind(PROBLEM_TOO_MANY)->retry_after);
	MHD_del_response_header(x->response, "Retry-After", text);
	snprintf(text, sizeof text, "%.0f", seconds);
	exchange_add_header(x, "Retry-After", text);
	return false;
}

static bool take(struct exchange *x, enum token_rate which, double amount)
{
	double wait = token_try(x->token, which, amount, clock_seconds());

	return wait <= 0.0 || refuse_rate(x, which, wait);
}

bool access_check(struct exchange *x)
{
	struct token_table *table;

	if (x->route->role == ROLE_NONE)
		return true;
	table = hold_table(x->server->access);
	if (table == NULL)
		return true;
	if (!identify(x, table)) {
		token_table_release(table);
		return false;
	}
	return check_role(x) && take(x, TOKEN_REQUESTS, 1.0) &&
	    take(x, TOKEN_BYTES, 0.0);
}

/* What so many points of program, or NULL, count as. */
static double weigh(const struct program *program, size_t count)
{
	const size_t nodes = program != NULL ? program->tape->node_count : 0;

	return (double)count * (double)(1 + nodes / ACCESS_POINT_NODES);
}

/* What alone would take hours is no matter of waiting. */
static bool check_size(struct exchange *x, double points)
{
	const double rate = x->token->rates[TOKEN_POINTS];

	if (!token_is_beyond(x->token, TOKEN_POINTS, points))
		return true;
	exchange_reply_problem(x, PROBLEM_LIMIT, NULL,
	    "This counts as %.4g points, more than '%s' may take in an hour "
	    "(points_per_second %.15g): ask for fewer points, or of a smaller "
	    "document, at a time.", points, x->token->name, rate);
	return false;
}

bool access_take_points(struct exchange *x, const struct program *program,
    size_t count)
{
	double nodes = 0.0, points;

	if (x->token == NULL)
		return true;
	if (program != NULL)
		nodes = (double)tables_nodes_unbuilt(x->server->tables,
		    program->entries, program->entry_count);
	points = weigh(program, count) + ACCESS_NODE_POINTS * nodes;
	return check_size(x, points) && take(x, TOKEN_POINTS, points);
}

void access_count_bytes(struct exchange *x, size_t bytes)
{
	/* Of refusals for coming too often there would be no end. */
	if (x->token != NULL && bytes > 0 && x->problem != PROBLEM_TOO_MANY)
		token_take(x->token, TOKEN_BYTES, (double)bytes,
		    clock_seconds());
}

void access_release(struct exchange *x)
{
	const struct token *token = x->token;

	x->token = NULL;
	access_let_go(token);
}

const struct token *access_keep(const struct exchange *x)
{
	if (x->token != NULL)
		token_table_hold(x->token->table);
	return x->token;
}

void access_charge_points(const struct token *token,
    const struct program *program, size_t count)
{
	if (token != NULL)
		token_take(token, TOKEN_POINTS, weigh(program, count),
		    clock_seconds());
}

void access_let_go(const struct token *token)
{
	if (token != NULL)
		token_table_release(token->table);
}

unsigned access_reloads(const struct access *a)
{
	return atomic_load(&a->reloads);
}

/* Whether table has t, with a role that is enough. */
static bool has_token(const struct token_table *table, const struct token *t,
    enum role needed)
{
	if (table == NULL)
		return false;
	for (size_t i = 0; i < table->count; i++) {
		const struct token *now = &table->tokens[i];

		if (strcmp(now->name, t->name) == 0)
			return now->role >= needed && memcmp(now->hash,
			    t->hash, TOKEN_HASH_BYTES) == 0;
	}
	return false;
}

bool access_is_still_allowed(struct access *a, const struct token *token,
    enum role needed)
{
	struct token_table *table;
	bool is_allowed;

	if (token == NULL)
		return true;
	table = hold_table(a);
	is_allowed = table == token->table || has_token(table, token, needed);
	token_table_release(table);
	return is_allowed;
}

void access_asker(const struct exchange *x, char out[static ACCESS_ASKER_SIZE])
{
	uint8_t address[TOKEN_ADDRESS_BYTES];
	const bool is_remote = find_address(x, address);
	int n = 0;

	out[0] = '\0';
	if (x->token != NULL && !token_is_anonymous(x->token)) {
		snprintf(out, ACCESS_ASKER_SIZE, "token %s", x->token->name);
	} else if (x->token != NULL || is_remote) {
		n = sprintf(out, "address ");
		for (int i = 0; i < TOKEN_ADDRESS_BYTES; i++)
			n += sprintf(out + n, "%02x", address[i]);
	}
}

const char *access_owner(const struct exchange *x)
{
	return x->token != NULL ? x->token->name : "";
}

size_t access_scenes_most(const struct exchange *x)
{
	return x->token != NULL ? x->token->scenes : SIZE_MAX;
}

size_t access_volume_bytes_most(const struct exchange *x)
{
	return x->token != NULL ? x->token->volume_bytes : SIZE_MAX;
}

/* ---- GET /v1/tokens ---- */

static void describe_limits(const struct token *t, cJSON *limits)
{
	for (int i = 0; i < TOKEN_RATE_COUNT; i++) {
		if (t->rates[i] > 0.0)
			cJSON_AddNumberToObject(limits,
			    token_rate_name((enum token_rate)i), t->rates[i]);
	}
	if (t->scenes != SIZE_MAX)
		cJSON_AddNumberToObject(limits, "scenes", (double)t->scenes);
	if (t->volume_bytes != SIZE_MAX)
		cJSON_AddNumberToObject(limits, "volume_bytes",
		    (double)t->volume_bytes);
}

static void describe_use(const struct token *t, cJSON *used)
{
	static const char *const names[TOKEN_RATE_COUNT] = {
		[TOKEN_REQUESTS] = "requests",
		[TOKEN_POINTS] = "points",
		[TOKEN_BYTES] = "bytes",
	};
	struct token_use *use = t->use;

	pthread_mutex_lock(&use->lock);
	for (int i = 0; i < TOKEN_RATE_COUNT; i++)
		cJSON_AddNumberToObject(used, names[i], use->taken[i]);
	cJSON_AddNumberToObject(used, "refused", use->refused);
	pthread_mutex_unlock(&use->lock);
}

static void describe(const struct token *t, cJSON *list)
{
	cJSON *json = cJSON_CreateObject();

	cJSON_AddItemToArray(list, json);
	cJSON_AddStringToObject(json, "name", t->name);
	cJSON_AddStringToObject(json, "role", role_name(t->role));
	describe_limits(t, cJSON_AddObjectToObject(json, "limits"));
	describe_use(t, cJSON_AddObjectToObject(json, "used"));
}

struct cJSON *access_describe(struct access *a)
{
	struct token_table *table = hold_table(a);
	cJSON *json = cJSON_CreateObject();
	cJSON *list = cJSON_AddArrayToObject(json, "tokens");

	for (size_t i = 0; table != NULL && list != NULL && i < table->count;
	    i++)
		describe(&table->tokens[i], list);
	token_table_release(table);
	return json;
}

/* ---- --make-token ---- */

static int complain(const char *what)
{
	fprintf(stderr, "blobfieldd: --make-token: %s\n", what);
	return 1;
}

/* A secret's entry: its name, 64 digits, and what is around them. */
#define ENTRY_MAX (TOKEN_NAME_MAX + 2 * TOKEN_HASH_BYTES + 64)

/* "bf_" and random bits in base32 (RFC 4648), small letters. */
static bool make_secret(char out[static SECRET_LETTERS + 4])
{
	static const char digits[] = "abcdefghijklmnopqrstuvwxyz234567";
	unsigned char random[SECRET_BYTES];

	if (getrandom(random, sizeof random, 0) != sizeof random)
		return false;
	strcpy(out, "bf_");
	for (int i = 0; i < SECRET_LETTERS; i++) {
		const int at = 5 * i / 8, shift = 5 * i % 8;
		const unsigned next = at + 1 < SECRET_BYTES ? random[at + 1] :
		    0;
		const unsigned bits = (unsigned)random[at] << 8 | next;

		out[3 + i] = digits[bits >> (11 - shift) & 31];
	}
	out[3 + SECRET_LETTERS] = '\0';
	return true;
}

/* For --tokens' file. */
static void make_entry(const char *name, enum role role, const char *secret,
    char out[static ENTRY_MAX])
{
	uint8_t hash[TOKEN_HASH_BYTES];

	token_hash(secret, strlen(secret), hash);
	snprintf(out, ENTRY_MAX, "{\"name\": \"%s\", \"role\": \"%s\", "
	    "\"sha256\": \"", name, role_name(role));
	for (int i = 0; i < TOKEN_HASH_BYTES; i++)
		sprintf(out + strlen(out), "%02x", hash[i]);
	strcat(out, "\"}");
}

int access_make_token(const char *name, const char *role)
{
	char secret[SECRET_LETTERS + 4], text[TOKEN_NAME_MAX + 1] = "";
	char entry[ENTRY_MAX];
	const char *colon = strchr(name, ':');
	const size_t length = colon != NULL ? (size_t)(colon - name) :
	    strlen(name);
	enum role which;

	if (colon != NULL)
		role = colon + 1;
	if (length < sizeof text)
		memcpy(text, name, length);
	if (!token_is_name(text))
		return complain("NAME:ROLE: a name is 1 to 64 of A-Z a-z 0-9 "
		    "_ . -");
	if (strcmp(text, TOKEN_ANONYMOUS) == 0)
		return complain("'anonymous' is for requests without a token: "
		    "it is written into the file without one");
	if (!role_named(role, &which))
		return complain("NAME:ROLE: a role is read, evaluate, write "
		    "or admin");
	if (!make_secret(secret))
		return complain("there are no random bytes");
	make_entry(text, which, secret, entry);
	printf("%s\n%s\n", secret, entry);
	if (fflush(stdout) != 0)
		return complain("cannot write");
	fprintf(stderr, "The first line is the token, for who asks: keep it, it "
	    "is nowhere else. The second\nis its entry in the file of "
	    "--tokens. With this one alone, that file (chmod 600) is\n"
	    "{\"tokens\": [%s]}\n", entry);
	return 0;
}

/* ---- public addresses ---- */

/* What "anonymous" may; ROLE_NONE: there is none. */
static enum role role_of_strangers(struct access *a)
{
	struct token_table *table = hold_table(a);
	enum role role = table->anonymous != NULL ? table->anonymous->role :
	    ROLE_NONE;

	token_table_release(table);
	return role;
}

/* Where there are tokens; host is public. */
static bool may_listen_closed(const struct server *server, const char *host)
{
	const struct config *config = server->config;
	const enum role role = role_of_strangers(server->access);

	if (config->tls_cert[0] == '\0')
		log_write(LOG_WARNING, "tokens travel in clear to %s: use "
		    "--tls-cert and --tls-key, or a proxy that speaks TLS",
		    host);
	if (role < ROLE_WRITE)
		return true;
	log_write(config->insecure ? LOG_WARNING : LOG_ERROR, "%s is a public "
	    "address, and tokens' entry \"anonymous\" has the role \"%s\": "
	    "whoever reaches it may read, change and delete everything%s", host,
	    role_name(role), config->insecure ? "" : ". Make that role read or "
	    "evaluate; or say --insecure");
	return config->insecure;
}

int access_check_listener(const struct server *server, int listener)
{
	const struct config *config = server->config;
	struct sockaddr_storage address = {0};
	socklen_t size = sizeof address;
	char host[128] = "?";

	if (listener < 0 || (getsockname(listener,
	    (struct sockaddr *)&address, &size) == 0 &&
	    is_loopback(&address)))
		return listener;
	getnameinfo((struct sockaddr *)&address, size, host, sizeof host,
	    NULL, 0, NI_NUMERICHOST);
	if (access_is_closed(server->access)) {
		if (may_listen_closed(server, host))
			return listener;
		close(listener);
		return -1;
	}
	if (config->insecure) {
		log_write(LOG_WARNING, "--insecure: whoever reaches %s may "
		    "read, change and delete everything", host);
		return listener;
	}
	log_write(LOG_ERROR, "%s is a public address, and there are no "
	    "tokens: whoever reaches it could read, change and delete "
	    "everything. Make a token with --make-token NAME:ROLE and give "
	    "--tokens FILE; or listen at 127.0.0.1; or say --insecure", host);
	close(listener);
	return -1;
}
