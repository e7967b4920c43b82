/*
 * Small texts that users and clients write, by the first byte: addresses of
 * Redis, files of tokens and of configuration, options' values, sequences,
 * preconditions, traces, origins. What is accepted is whole and within its
 * bounds; what is refused says why.
 */
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "proto/fault.h"
#include "proto/text.h"
#include "server/backing_redis_url.h"
#include "server/config_internal.h"
#include "server/cors.h"
#include "server/etag.h"
#include "server/exchange.h"
#include "server/log.h"
#include "server/scene_seq.h"
#include "server/server.h"
#include "server/token.h"
#include "server/trace.h"

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void demand(int fine)
{
	if (!fine)
		abort();
}

/* ---- played: an exchange of one header ---- */

static const char *header;

const char *exchange_header(struct exchange *x, const char *name)
{
	(void)x, (void)name;
	return header;
}

void exchange_add_header(struct exchange *x, const char *name,
    const char *value)
{
	(void)x;
	demand(name != NULL && value != NULL);
}

/* ---- Redis' address ---- */

static bool ends_within(const char *text, size_t size)
{
	return memchr(text, '\0', size) != NULL;
}

static void try_redis_url(const char *text)
{
	struct backing_redis_url url;
	const char *why = NULL;

	if (backing_redis_url_parse(text, &url, &why) != ERR_OK) {
		demand(why != NULL && why[0] != '\0');
		return;
	}
	demand(url.host[0] != '\0' && ends_within(url.host, sizeof url.host));
	demand(ends_within(url.user, sizeof url.user) &&
	    ends_within(url.password, sizeof url.password) &&
	    ends_within(url.prefix, sizeof url.prefix) &&
	    ends_within(url.shown, sizeof url.shown));
	demand(url.port >= 0 && url.port <= 65535);
	demand(url.database >= 0 && url.database <= 65535);
}

/* ---- tokens ---- */

static void check_faults(const struct faults *faults)
{
	demand(faults->count > 0);
	for (size_t i = 0; i < faults->count && i < FAULT_MAX; i++)
		demand(faults->list[i].detail[0] != '\0');
}

static void check_token(const struct token *token)
{
	demand(token_is_name(token->name));
	demand(token->role > ROLE_NONE && token->role < ROLE_COUNT);
	for (int i = 0; i < TOKEN_RATE_COUNT; i++)
		demand(isfinite(token->rates[i]) && token->rates[i] >= 0.0);
	demand(isfinite(token_try(token, TOKEN_POINTS, 1e6, 1.0)));
	token_take(token, TOKEN_BYTES, 1e9, 1.5);
	demand(isfinite(token_try(token, TOKEN_BYTES, 1.0, 2.0)));
}

static void try_tokens(const char *text, size_t length)
{
	struct token_table *table, *again;
	struct faults faults = {0};

	if (token_table_read(text, length, NULL, &table, &faults) != ERR_OK) {
		check_faults(&faults);
		return;
	}
	demand(faults.count == 0 && table->count <= TOKENS_MAX);
	for (size_t i = 0; i < table->count; i++)
		check_token(&table->tokens[i]);
	token_find(table, text, length);
	demand(token_table_read(text, length, table, &again, &faults) ==
	    ERR_OK);
	token_table_release(table);
	demand(again->count == 0 || again->tokens[0].use != NULL);
	token_table_release(again);
}

/* ---- configuration ---- */

/* One that a file's reader can fill. */
static void begin_reading(struct config_reading *reading,
    struct config *config)
{
	memset(config, 0, sizeof *config);
	memset(reading, 0, sizeof *reading);
	reading->config = config;
}

/* What a value is printed as is read as the same. */
static void check_option(const struct config_option *option,
    const struct config *config)
{
	static struct config again;
	char text[CONFIG_VALUE_MAX], second[CONFIG_VALUE_MAX];
	char why[CONFIG_WHY_MAX];

	if (!config_value_print(option, config, text) || text[0] == '\0' ||
	    strcmp(text, "0") == 0 || text[0] == ':')
		return;
	again = *config;
	demand(config_value_read(option, text, &again, why));
	demand(config_value_print(option, &again, second));
	demand(strcmp(text, second) == 0);
}

static void try_config_file(const char *text, size_t length)
{
	static struct config_reading reading;
	static struct config config;
	char path[64];
	int fd = memfd_create("config", MFD_CLOEXEC);

	demand(fd >= 0 && write(fd, text, length) == (ssize_t)length);
	snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
	begin_reading(&reading, &config);
	reading.path = path;
	if (config_file_read(&reading))
		for (const struct config_option *o = config_options;
		    o->name != NULL; o++)
			if (config_option_is_kept(o) &&
			    o->kind != CONFIG_PRESET && o->kind != CONFIG_PATH)
				check_option(o, &config);
	close(fd);
}

/* The option is told by the text's first byte. */
static void try_config_value(const char *text)
{
	static struct config config;
	const struct config_option *option = config_options;
	char why[CONFIG_WHY_MAX], shown[CONFIG_VALUE_MAX];
	int skip = text[0] % 48;

	while (skip-- > 0 && option[1].name != NULL)
		option++;
	text += text[0] != '\0';
	config_option_like(text);
	config_value_hide(text, shown);
	demand(ends_within(shown, sizeof shown));
	if (option->kind == CONFIG_PRESET || option->kind == CONFIG_PATH)
		return;
	memset(&config, 0, sizeof config);
	why[0] = '\0';
	if (!config_value_read(option, text, &config, why))
		demand(why[0] != '\0' && ends_within(why, sizeof why));
	else if (option->kind != CONFIG_TOKEN && option->kind != CONFIG_DEED)
		check_option(option, &config);
}

/* ---- headers ---- */

static void try_sequence(const char *text)
{
	struct scene_seq seq, again;
	char printed[SCENE_SEQ_SIZE];

	if (!scene_seq_parse(text, &seq))
		return;
	scene_seq_print(seq, printed);
	demand(scene_seq_parse(printed, &again));
	demand(scene_seq_compare(seq, again) == 0);
}

static void try_precondition(const char *text)
{
	static const char tag[] = "\"0123456789abcdef0123456789abcdef\"";
	struct precondition p = {.match = text};
	bool is_valid = precondition_is_valid(&p);
	bool is_met = precondition_match(&p, tag);

	demand(!is_met || is_valid || strstr(text, tag) != NULL);
	demand(!precondition_match(&p, NULL));
	p = (struct precondition){.none_match = text};
	demand(precondition_is_valid(&p) == is_valid);
	demand(precondition_none_match(&p, NULL));
	/* What matches strongly does so weakly. */
	demand(!is_met || !precondition_none_match(&p, tag));
}

static void try_trace(const char *text)
{
	struct exchange x = {0};

	header = text;
	trace_begin(&x);
	demand(strlen(x.request_id) >= 1 &&
	    strlen(x.request_id) <= TRACE_ID_MAX);
	demand(strlen(x.trace_id) == 32 || x.trace_id[0] == '\0');
	demand(strlen(x.parent_id) == 16 || x.parent_id[0] == '\0');
	demand(x.trace_id[0] != '\0' || x.parent_id[0] == '\0');
	trace_add_headers(&x);
}

/* A list of origins, and the origin that asks, parted by LF. */
static void try_origins(char *text)
{
	static struct config config;
	struct server server = {.config = &config};
	struct exchange x = {.server = &server};
	char *gap = strchr(text, '\n');

	header = gap != NULL ? gap + 1 : text;
	if (gap != NULL)
		*gap = '\0';
	if (!cors_check(text) || strlen(text) >= sizeof config.cors)
		return;
	strcpy(config.cors, text);
	cors_add_headers(&x);
	cors_preflight(&x, "GET");
}

static void try_target(const char *text)
{
	char out[200];

	log_mask_target(text, out, sizeof out);
	demand(ends_within(out, sizeof out));
	log_mask_target(text, out, 9);
	demand(ends_within(out, 9));
}

/* What is said is lost. */
int LLVMFuzzerInitialize(int *argc, char ***argv)
{
	(void)argc, (void)argv;
	stderr = fopen("/dev/null", "w");
	demand(stderr != NULL);
	return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
	size_t length = size - 1;
	char *text;

	if (size == 0)
		return 0;
	text = malloc(size);
	demand(text != NULL);
	memcpy(text, data + 1, length);
	text[length] = '\0';
	switch (data[0] % 9) {
	case 0:
		try_redis_url(text);
		break;
	case 1:
		try_tokens(text, length);
		break;
	case 2:
		try_config_file(text, length);
		break;
	case 3:
		try_config_value(text);
		break;
	case 4:
		try_sequence(text);
		break;
	case 5:
		try_precondition(text);
		break;
	case 6:
		try_trace(text);
		break;
	case 7:
		try_origins(text);
		break;
	case 8:
		try_target(text);
		break;
	}
	free(text);
	return 0;
}
