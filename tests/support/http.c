#include "tests/support/http.h"

#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include <curl/curl.h>

struct text {
	char *bytes;
	size_t length, size;
};

static size_t append(char *data, size_t size, size_t count, void *ctx)
{
	struct text *text = ctx;
	size_t n = size * count;

	if (text->length + n + 1 > text->size) {
		size_t larger = 2 * (text->length + n + 1);
		char *bytes = realloc(text->bytes, larger);

		if (bytes == NULL)
			return 0;
		text->bytes = bytes;
		text->size = larger;
	}
	memcpy(text->bytes + text->length, data, n);
	text->length += n;
	text->bytes[text->length] = '\0';
	return n;
}

static struct curl_slist *make_headers(const struct http_request *request)
{
	/* libcurl would wait a second for 100 Continue. */
	struct curl_slist *list = curl_slist_append(NULL, "Expect:");

	for (size_t i = 0; i < 6 && request->headers[i] != NULL; i++)
		list = curl_slist_append(list, request->headers[i]);
	return list;
}

static void set_request(CURL *curl, const struct http_request *request)
{
	if (request->body != NULL) {
		curl_easy_setopt(curl, CURLOPT_POST, 1L);
		curl_easy_setopt(curl, CURLOPT_POSTFIELDS, request->body);
		curl_easy_setopt(curl, CURLOPT_POSTFIELDSIZE_LARGE,
		    (curl_off_t)request->length);
	}
	if (request->method != NULL && strcmp(request->method, "HEAD") == 0)
		curl_easy_setopt(curl, CURLOPT_NOBODY, 1L);
	else if (request->method != NULL)
		curl_easy_setopt(curl, CURLOPT_CUSTOMREQUEST,
		    request->method);
}

void http_do(const char *url, const struct http_request *request,
    struct http_reply *out)
{
	struct text head = {0}, body = {0};
	struct curl_slist *headers = make_headers(request);
	CURL *curl = curl_easy_init();
	char full[512], why[CURL_ERROR_SIZE] = "";
	CURLcode code;

	snprintf(full, sizeof full, "%s%s", url, request->path);
	*out = (struct http_reply){0};
	curl_easy_setopt(curl, CURLOPT_URL, full);
	curl_easy_setopt(curl, CURLOPT_ERRORBUFFER, why);
	curl_easy_setopt(curl, CURLOPT_PATH_AS_IS, 1L);
	curl_easy_setopt(curl, CURLOPT_NOSIGNAL, 1L);
	curl_easy_setopt(curl, CURLOPT_NOPROXY, "*");
	curl_easy_setopt(curl, CURLOPT_TIMEOUT, 300L);
	curl_easy_setopt(curl, CURLOPT_HTTPHEADER, headers);
	curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, append);
	curl_easy_setopt(curl, CURLOPT_WRITEDATA, &body);
	curl_easy_setopt(curl, CURLOPT_HEADERFUNCTION, append);
	curl_easy_setopt(curl, CURLOPT_HEADERDATA, &head);
	set_request(curl, request);
	code = curl_easy_perform(curl);
	if (code == CURLE_OK)
		curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &out->status);
	else
		fprintf(stderr, "no answer: %s %s: %s\n", request->method !=
		    NULL ? request->method : "", full, why[0] != '\0' ? why :
		    curl_easy_strerror(code));
	curl_easy_cleanup(curl);
	curl_slist_free_all(headers);
	out->headers = head.bytes;
	out->length = body.length;
	out->body = body.bytes != NULL ? body.bytes : calloc(1, 1);
}

void http_get(const char *url, const char *path, struct http_reply *out)
{
	http_do(url, &(struct http_request){.path = path}, out);
}

void http_json(const char *url, const char *method, const char *path,
    const char *body, struct http_reply *out)
{
	http_do(url, &(struct http_request){
		.method = method,
		.path = path,
		.body = body,
		.length = strlen(body),
		.headers = {"Content-Type: application/json"},
	}, out);
}

void http_reply_fini(struct http_reply *reply)
{
	free(reply->headers);
	free(reply->body);
	reply->headers = reply->body = NULL;
}

char *http_header(const struct http_reply *reply, const char *name, char *out,
    size_t size)
{
	size_t length = strlen(name);
	const char *line = reply->headers != NULL ? reply->headers : "";

	out[0] = '\0';
	for (; *line != '\0'; line += strcspn(line, "\n")) {
		line += strspn(line, "\r\n");
		if (strncasecmp(line, name, length) == 0 &&
		    line[length] == ':') {
			line += length + 1;
			line += strspn(line, " ");
			snprintf(out, size, "%.*s",
			    (int)strcspn(line, "\r\n"), line);
			break;
		}
	}
	return out;
}

int http_connect(int port)
{
	struct sockaddr_in address = {
		.sin_family = AF_INET,
		.sin_port = htons((uint16_t)port),
		.sin_addr.s_addr = htonl(INADDR_LOOPBACK),
	};
	int fd = socket(AF_INET, SOCK_STREAM, 0);

	assert_true(fd >= 0);
	assert_int_equal(connect(fd, (struct sockaddr *)&address,
	    sizeof address), 0);
	return fd;
}

int http_raw(int port, const char *bytes, size_t length, char *out,
    size_t size)
{
	int fd = http_connect(port);
	struct pollfd poll_fd = {.fd = fd, .events = POLLIN};
	size_t got = 0;
	int status = 0;
	ssize_t n;

	/* The server may close before it has read all of it. */
	while (length > 0 && (n = send(fd, bytes, length, MSG_NOSIGNAL)) > 0) {
		bytes += n;
		length -= (size_t)n;
	}
	while (got < size - 1 && poll(&poll_fd, 1, 30000) == 1 &&
	    (n = recv(fd, out + got, size - 1 - got, 0)) > 0)
		got += (size_t)n;
	out[got] = '\0';
	close(fd);
	sscanf(out, "HTTP/1.1 %d", &status);
	return status;
}
