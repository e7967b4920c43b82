/*
 * Who may do what: bearer tokens with roles and limits, out of a file of hashed
 * secrets (--tokens). Without such a file everybody may do everything.
 *
 * Threads: access_reload replaces the table while others use it; an exchange
 * holds the token that it came with. Everything here is safe from any thread.
 */
#ifndef SERVER_ACCESS_H
#define SERVER_ACCESS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct access;
struct cJSON;
struct config;
struct exchange;
struct program;
struct server;
struct token;

/* Each has the rights of those before it. */
enum role {
	ROLE_NONE,     /* no token is asked for: probes, the previewer's files */
	ROLE_READ,
	ROLE_EVALUATE,
	ROLE_WRITE,
	ROLE_ADMIN,
	ROLE_COUNT
};

#define TOKEN_NAME_MAX 64

/* Reads config's file of tokens, if there is one. ERR_INVALID, ERR_IO (the log
 * says at which place, and why), ERR_MEMORY. */
enum err access_create(const struct config *config, struct access **out);

/* NULL does nothing. */
void access_free(struct access *a);

/* Reads the file anew; what is wrong with it is logged, and changes nothing.
 * Tokens of the same name keep what they have used. */
enum err access_reload(struct access *a);

/* Whether there are tokens at all. */
bool access_is_closed(const struct access *a);

/*
 * When x's route is known, before its body: finds its token, in x->token, and
 * checks its role and its limits of rate and bytes. False: answered with 401,
 * 403 or 429.
 */
bool access_check(struct exchange *x);

/*
 * Before an evaluation of program at so many points: false: answered with 429.
 * A point of a program of N nodes counts as 1 + N / ACCESS_POINT_NODES points,
 * rounded down. Operator tables that would have to be built first count as
 * well, ACCESS_NODE_POINTS for each of their nodes. program may be NULL.
 */
bool access_take_points(struct exchange *x, const struct program *program,
    size_t count);

/* A node takes 1.7 microseconds of a core, a point of a small scene 0.1 (the
 * letter A at 1e7 points a second). */
#define ACCESS_NODE_POINTS 16

/* 32726 instances of one point, all alive everywhere, take 110 microseconds a
 * point, 1100 times as long as the letter A; but of most models of many nodes
 * few are alive at a point. */
#define ACCESS_POINT_NODES 64

/* A body of so many bytes has arrived, or an answer has been sent: counted, not
 * refused; the next request is where the limit bites. */
void access_count_bytes(struct exchange *x, size_t bytes);

/* x is over: gives up its token. */
void access_release(struct exchange *x);

/*
 * The same for work that goes on without x, whose points are counted once they
 * are known: x's token, or NULL, until it is let go; and what has been evaluated
 * for it, which may take it into debt. Any thread.
 */
const struct token *access_keep(const struct exchange *x);
void access_charge_points(const struct token *token,
    const struct program *program, size_t count);
void access_let_go(const struct token *token);

/*
 * Who x is of, for limits on what one may hold at a time: its token; without
 * one its address (of IPv6 its /64); "" for this machine's own programs where
 * there are no tokens, which nobody tells apart.
 */
#define ACCESS_ASKER_SIZE 80
void access_asker(const struct exchange *x,
    char out[static ACCESS_ASKER_SIZE]);

/* How often the file has been read anew; and whether a token of before, or NULL,
 * would be let in now as well. Any thread. */
unsigned access_reloads(const struct access *a);
bool access_is_still_allowed(struct access *a, const struct token *token,
    enum role needed);

/* The name that scenes made by x are counted under, "" for none; and how many
 * of them there may be, SIZE_MAX for any number. */
const char *access_owner(const struct exchange *x);
size_t access_scenes_most(const struct exchange *x);

/* The same of volumes, the bytes that they take. */
size_t access_volume_bytes_most(const struct exchange *x);

/* For GET /v1/tokens: names, roles, limits, what has been used. */
struct cJSON *access_describe(struct access *a);

/* --make-token NAME ROLE, or NAME:ROLE as the name: prints a new secret on
 * stdout, and the entry for the file. 0, or 1 with the reason on stderr. */
int access_make_token(const char *name, const char *role);

/*
 * listener, or, having closed it, -1 where it is bound to an address that others
 * than this machine reach, there is no --insecure, and there are no tokens, or
 * those without one may write: the log says what to do. Sockets that were handed to the daemon count as well;
 * AF_UNIX's are local.
 */
int access_check_listener(const struct server *server, int listener);

#endif
