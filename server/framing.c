#include "server/framing.h"

#include <errno.h>
#include <microhttpd.h>
#include <stdlib.h>
#include <string.h>

#include "server/config.h"
#include "server/exchange.h"
#include "server/server.h"

enum counted {
	HOST,
	CONTENT_LENGTH,
	TRANSFER_ENCODING,
	CONTENT_TYPE,
	COUNTED
};

static const char *const names[COUNTED] = {
	[HOST] = "Host",
	[CONTENT_LENGTH] = "Content-Length",
	[TRANSFER_ENCODING] = "Transfer-Encoding",
	[CONTENT_TYPE] = "Content-Type",
};

static enum MHD_Result count(void *ctx, enum MHD_ValueKind kind,
    const char *key, const char *value)
{
	unsigned *counts = ctx;

	(void)kind, (void)value;
	for (int i = 0; i < COUNTED; i++) {
		if (strcasecmp(key, names[i]) == 0)
			counts[i]++;
	}
	return MHD_YES;
}

static bool refuse(struct exchange *x, enum problem problem,
    const char *detail)
{
	exchange_reply_problem(x, problem, NULL, "%s", detail);
	return false;
}

static bool check_counts(struct exchange *x, const char *version)
{
	unsigned counts[COUNTED] = {0};

	MHD_get_connection_values(x->connection, MHD_HEADER_KIND, count,
	    counts);
	if (strcmp(version, "HTTP/1.1") == 0 && counts[HOST] == 0)
		return refuse(x, PROBLEM_MALFORMED,
		    "An HTTP/1.1 request needs a Host header.");
	for (int i = 0; i < COUNTED; i++) {
		if (counts[i] < 2)
			continue;
		exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
		    "There is more than one %s header.", names[i]);
		return false;
	}
	if (counts[CONTENT_LENGTH] > 0 && counts[TRANSFER_ENCODING] > 0)
		return refuse(x, PROBLEM_MALFORMED, "Content-Length and "
		    "Transfer-Encoding exclude each other.");
	return true;
}

static bool check_encodings(struct exchange *x)
{
	const char *transfer = exchange_header(x, "Transfer-Encoding");
	const char *content = exchange_header(x, "Content-Encoding");

	if (transfer != NULL && strcasecmp(transfer, "chunked") != 0)
		return refuse(x, PROBLEM_NOT_IMPLEMENTED,
		    "The only Transfer-Encoding known here is chunked.");
	if (content != NULL && content[0] != '\0' &&
	    strcasecmp(content, "identity") != 0) {
		exchange_reply_problem(x, PROBLEM_MEDIA_TYPE, NULL,
		    "Content-Encoding '%.60s': bodies must not be compressed.",
		    content);
		exchange_add_header(x, "Accept-Encoding", "identity");
		return false;
	}
	return true;
}

static bool check_length(struct exchange *x)
{
	const char *text = exchange_header(x, "Content-Length");
	size_t most = x->server->config->max_body;
	unsigned long long length;
	char *end;

	if (text == NULL)
		return true;
	errno = 0;
	length = strtoull(text, &end, 10);
	if (strspn(text, "0123456789") != strlen(text) || text[0] == '\0')
		return refuse(x, PROBLEM_MALFORMED,
		    "Content-Length is not a number.");
	if (errno == 0 && length <= most)
		return true;
	exchange_reply_problem(x, PROBLEM_TOO_LARGE, NULL,
	    "The body has %.30s bytes; this server takes %zu at most.", text,
	    most);
	return false;
}

bool framing_check(struct exchange *x, const char *version)
{
	if (strcmp(version, "HTTP/1.1") != 0 &&
	    strcmp(version, "HTTP/1.0") != 0)
		return refuse(x, PROBLEM_VERSION,
		    "This server speaks HTTP/1.1 and HTTP/1.0.");
	return check_counts(x, version) && check_encodings(x) &&
	    check_length(x);
}
