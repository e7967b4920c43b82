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

/* Where a head is not what it seems, what follows is no request. */
static bool refuse(struct exchange *x, enum problem problem,
    const char *detail)
{
	exchange_reply_problem(x, problem, NULL, "%s", detail);
	exchange_add_header(x, "Connection", "close");
	return false;
}

/* ---- the head's bytes ---- */

/*
 * libmicrohttpd parses a head in place: it puts a NUL for each colon behind a
 * name and for each of CR and LF, and skips blanks before a value. What it lets
 * pass shows in what lies between the strings that it hands out: lines that end
 * with LF only, NULs, and lines that go on in the next one, which it would take
 * for a part of the name.
 */
struct head {
	const char *at, *end; /* what has not been looked at yet */
	const char *wrong;    /* or NULL */
};

static bool is_token_char(char c)
{
	return (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') ||
	    (c >= 'a' && c <= 'z') ||
	    (c != '\0' && strchr("!#$%&'*+-.^_`|~", c) != NULL);
}

/* The length of the token that text begins with (RFC 9110, section 5.6.2). */
static size_t token_length(const char *text)
{
	size_t n = 0;

	while (is_token_char(text[n]))
		n++;
	return n;
}

/* What may be in a value (section 5.5): also bytes above ASCII. */
static size_t value_length(const char *text)
{
	size_t n = 0;

	while (text[n] == '\t' || (unsigned char)text[n] >= 128 ||
	    (text[n] >= ' ' && text[n] < 127))
		n++;
	return n;
}

static bool skip_line_end(struct head *head)
{
	if (head->end - head->at < 2 || head->at[0] != '\0' ||
	    head->at[1] != '\0')
		return false;
	head->at += 2;
	return true;
}

/* Whether the next line, as it was sent, is this header. */
static enum MHD_Result scan_line(void *ctx, enum MHD_ValueKind kind,
    const char *key, const char *value)
{
	struct head *head = ctx;
	size_t length;

	(void)kind;
	if (key != head->at || value == NULL) {
		head->wrong = "Header lines must end with CR LF, have no NUL, "
		    "and not go on in the next line.";
		return MHD_NO;
	}
	length = token_length(key);
	if (length == 0 || key[length] != '\0') {
		head->wrong = "A header's name has other characters than "
		    "letters, digits and !#$%&'*+-.^_`|~ before its colon.";
		return MHD_NO;
	}
	head->at += length + 1;
	head->at += strspn(head->at, " \t");
	if (head->at == value)
		head->at += value_length(value);
	if (skip_line_end(head))
		return MHD_YES;
	head->wrong = "A header's value has control characters, or its line "
	    "does not end with CR LF.";
	return MHD_NO;
}

/* Whether the head is, byte by byte, what libmicrohttpd has made of it. */
static bool scan_head(struct exchange *x, const char *version)
{
	const union MHD_ConnectionInfo *info = MHD_get_connection_info(
	    x->connection, MHD_CONNECTION_INFO_REQUEST_HEADER_SIZE);
	struct head head = {version + strlen(version),
	    x->method + info->header_size, NULL};
	const char *target = x->target_end - x->target_length;
	size_t length = token_length(x->method);
	const char *blanks = x->method + length + 1;

	if (length == 0 || x->method[length] != '\0' ||
	    blanks + strspn(blanks, " ") != target)
		return refuse(x, PROBLEM_MALFORMED, "The request's method has "
		    "other characters than a method may have.");
	if (x->target_is_odd)
		return refuse(x, PROBLEM_MALFORMED, "There are blanks or "
		    "control characters in the request's target.");
	if (!skip_line_end(&head))
		return refuse(x, PROBLEM_MALFORMED,
		    "The request line does not end with CR LF.");
	MHD_get_connection_values(x->connection, MHD_HEADER_KIND, scan_line,
	    &head);
	if (head.wrong != NULL)
		return refuse(x, PROBLEM_MALFORMED, head.wrong);
	if (!skip_line_end(&head) || head.at != head.end)
		return refuse(x, PROBLEM_MALFORMED,
		    "The head does not end with one empty line of CR LF.");
	return true;
}

/* ---- what it says ---- */

/* "", or a colon and the digits of a port. */
static bool is_port(const char *text)
{
	size_t digits = text[0] == ':' ? strspn(text + 1, "0123456789") : 0;

	text += text[0] == ':' ? 1 + digits : 0;
	return text[strspn(text, " \t")] == '\0' && digits <= 5;
}

/* uri-host [ ":" port ] (RFC 3986, section 3.2.2), and some more. */
static bool is_host(const char *text)
{
	static const char name[] = "0123456789-._~%!$&'()*+,;="
	    "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz";
	static const char address[] = "0123456789ABCDEFabcdef:.";
	size_t length;

	if (text[0] != '[') {
		length = strspn(text, name);
		return length > 0 && is_port(text + length);
	}
	length = strspn(text + 1, address);
	return length > 0 && text[length + 1] == ']' &&
	    is_port(text + length + 2);
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
		exchange_add_header(x, "Connection", "close");
		return false;
	}
	if (headers[HOST].value != NULL && !is_host(headers[HOST].value))
		return refuse(x, PROBLEM_MALFORMED,
		    "The Host header is no host, with or without a port.");
	if (headers[CONTENT_LENGTH].count > 0 &&
	    headers[TRANSFER_ENCODING].count > 0)
		return refuse(x, PROBLEM_MALFORMED, "Content-Length and "
		    "Transfer-Encoding exclude each other.");
	return true;
}

static bool check_encodings(struct exchange *x, const char *version,
    const struct header headers[static COUNTED])
{
	const char *transfer = headers[TRANSFER_ENCODING].value;
	const char *content = headers[CONTENT_ENCODING].value;

	if (transfer != NULL && strcmp(version, "HTTP/1.0") == 0)
		return refuse(x, PROBLEM_MALFORMED,
		    "There is no Transfer-Encoding in HTTP/1.0.");
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
	return scan_head(x, version) && check_counts(x, version, headers) &&
	    check_encodings(x, version, headers) &&
	    check_length(x, headers[CONTENT_LENGTH].value);
}
