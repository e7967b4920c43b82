#include <netinet/in.h>
#include <string.h>
#include <sys/socket.h>

#include "server/http_accept.h"

bool accept_key_of(const struct sockaddr *address, struct accept_key *out)
{
	const struct sockaddr_in6 *six = (const void *)address;
	const struct sockaddr_in *four = (const void *)address;

	memset(out, 0, sizeof *out);
	if (address->sa_family == AF_INET) {
		out->bytes[10] = out->bytes[11] = 0xff;
		memcpy(out->bytes + 12, &four->sin_addr, 4);
		return true;
	}
	if (address->sa_family != AF_INET6)
		return false;
	memcpy(out->bytes, &six->sin6_addr,
	    IN6_IS_ADDR_V4MAPPED(&six->sin6_addr) ? 16 : 8);
	return true;
}
