/*
 * Which addresses count as one (server/http_accept.h).
 */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <stdint.h>
#include <cmocka.h>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <string.h>
#include <sys/socket.h>

#include "server/http_accept.h"

static struct accept_key key_of(const char *text)
{
	struct sockaddr_storage storage = {0};
	struct sockaddr_in *four = (struct sockaddr_in *)&storage;
	struct sockaddr_in6 *six = (struct sockaddr_in6 *)&storage;
	struct accept_key key;

	if (inet_pton(AF_INET, text, &four->sin_addr) == 1) {
		four->sin_family = AF_INET;
	} else {
		assert_int_equal(inet_pton(AF_INET6, text, &six->sin6_addr),
		    1);
		six->sin6_family = AF_INET6;
		six->sin6_port = 1234;
		six->sin6_scope_id = 1;
	}
	assert_true(accept_key_of((struct sockaddr *)&storage, &key));
	return key;
}

static int is_same(const char *a, const char *b)
{
	struct accept_key one = key_of(a), other = key_of(b);

	return memcmp(&one, &other, sizeof one) == 0;
}

static void test_ipv4_is_counted_by_address(void **state)
{
	(void)state;
	assert_true(is_same("192.0.2.1", "192.0.2.1"));
	assert_false(is_same("192.0.2.1", "192.0.2.2"));
	assert_true(is_same("192.0.2.1", "::ffff:192.0.2.1"));
	assert_false(is_same("::ffff:192.0.2.1", "::ffff:192.0.2.2"));
}

static void test_ipv6_is_counted_by_64_bits(void **state)
{
	(void)state;
	assert_true(is_same("2001:db8:1:2::1", "2001:db8:1:2:ffff::9"));
	assert_false(is_same("2001:db8:1:2::1", "2001:db8:1:3::1"));
}

static void test_others_are_not_counted(void **state)
{
	const struct sockaddr address = {.sa_family = AF_UNIX};
	struct accept_key key;

	(void)state;
	assert_false(accept_key_of(&address, &key));
}

int main(void)
{
	const struct CMUnitTest tests[] = {
		cmocka_unit_test(test_ipv4_is_counted_by_address),
		cmocka_unit_test(test_ipv6_is_counted_by_64_bits),
		cmocka_unit_test(test_others_are_not_counted),
	};

	return cmocka_run_group_tests(tests, NULL, NULL);
}
