"""Connections that the tests' HTTP clients may keep."""

import httpx

# The service closes a connection that is idle for some seconds; a request sent at that instant is lost with it.
NO_IDLE_CONNECTIONS = httpx.Limits(max_keepalive_connections=0)
