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
	ONCE,             /* those above may come once only */
	CONTENT_ENCODING = ONCE,
	COUNTED
};

static const char *const names[COUNTED] = {
	[HOST] = "Host",
	[CONTENT_LENGTH] = "Content-Length",
	[TRANSFER_ENCODING] = "Transfer-Encoding",
	[CONTENT_TYPE] = "Content-Type",
	[CONTENT_ENCODING] = "Content-Encoding",
};

/* One of them: how often it came, and the first value, NULL if it has none. */
struct header {
	unsigned count;
	const char *value;
};

static enum MHD_Result count(void *ctx, enum MHD_ValueKind kind,
    const char *key, const char *value)
{
	struct header *headers = ctx;

	(void)kind;
	for (int i = 0; i < COUNTED; i++) {
		if (strcasecmp(key, names[i]) == 0 && headers[i].count++ == 0)
			headers[i].value = value;
	}
	return MHD_YES;
}

static bool refuse(struct exchange *x, enum problem problem,
    const char *detail)
{
	exchange_reply_problem(x, problem, NULL, "%s", detail);
	return false;
}

static bool check_counts(struct exchange *x, const char *version,
    const struct header headers[static COUNTED])
{
	if (strcmp(version, "HTTP/1.1") == 0 && headers[HOST].count == 0)
		return refuse(x, PROBLEM_MALFORMED,
		    "An HTTP/1.1 request needs a Host header.");
	for (int i = 0; i < ONCE; i++) {
		if (headers[i].count < 2)
			continue;
		exchange_reply_problem(x, PROBLEM_MALFORMED, NULL,
		    "There is more than one %s header.", names[i]);
		return false;
	}
	if (headers[CONTENT_LENGTH].count > 0 &&
	    headers[TRANSFER_ENCODING].count > 0)
		return refuse(x, PROBLEM_MALFORMED, "Content-Length and "
		    "Transfer-Encoding exclude each other.");
	return true;
}

static bool check_encodings(struct exchange *x,
    const struct header headers[static COUNTED])
{
	const char *transfer = headers[TRANSFER_ENCODING].value;
	const char *content = headers[CONTENT_ENCODING].value;

	if (transfer != NULL && strcasecmp(transfer, "chunked") != 0)
		return refuse(x, PROBLEM_NOT_IMPLEMENTED,
		    "The only Transfer-Encoding known here is chunked.");
	if (headers[CONTENT_ENCODING].count > 1)
		content = exchange_header(x, names[CONTENT_ENCODING]);
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

static bool check_length(struct exchange *x, const char *text)
{
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
	if (errno == 0 && length <= most) {
		x->promised = (size_t)length;
		return true;
	}
	exchange_reply_problem(x, PROBLEM_TOO_LARGE, NULL,
	    "The body has %.30s bytes; this server takes %zu at most.", text,
	    most);
	return false;
}

bool framing_check(struct exchange *x, const char *version)
{
	struct header headers[COUNTED] = {{0, NULL}};

	if (strcmp(version, "HTTP/1.1") != 0 &&
	    strcmp(version, "HTTP/1.0") != 0)
		return refuse(x, PROBLEM_VERSION,
		    "This server speaks HTTP/1.1 and HTTP/1.0.");
	MHD_get_connection_values(x->connection, MHD_HEADER_KIND, count,
	    headers);
	return check_counts(x, version, headers) &&
	    check_encodings(x, headers) &&
	    check_length(x, headers[CONTENT_LENGTH].value);
}
