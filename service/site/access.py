"""Access rules of the site bus, and the zenoh configurations that enforce them.

Default is deny. A cell may put under its own name only; the monitor may query and put nothing; no peer may
put anything towards a cell, so there is no key that could command one. Every subject carries a common name: an empty
property of a subject would be a wildcard.

Asking is given for the whole site in one rule: access is by inclusion, and the monitor's one subscription for all
cells would silently be unserved by rules that name one cell each. Only the monitor may begin to ask.
"""

from typing import Any

from cellcal.service.site.keys import MONITOR_NAME, ROOT, ROUTER_NAME, StationKeys, everything_below

CELL_MESSAGES = ["put", "delete", "reply", "declare_queryable", "liveliness_token"]
ASKING = ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"]
LEASE_MS = 2500  # a pulled cable closes no connection
_RETRY = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}
_MOST_SESSIONS = 10_000
# a thousand cells send at once, and all of it leaves through the monitor's one link: two batches and 1 ms, the
# default, lose some on a busy computer
_QUEUE = {"size": {"data": 16}, "congestion_control": {"drop": {"wait_before_drop": 20_000}}}
# joints come ten times a second, on a busy computer unevenly; what comes sooner than this allows after the one before
# is dropped, so the allowance is wide: a healthy cell loses none, one that floods is heard a few times as often
MOST_JOINTS_HZ = 50.0

Config = dict[str, Any]


def router_config(site: str, listen: str, cells: list[str]) -> Config:
    """Return the configuration of the site's router: the only listener."""
    transport = _transport_config(ROUTER_NAME)
    transport["unicast"] = {"max_sessions": _MOST_SESSIONS, "accept_pending": 1000}
    transport["link"]["tx"]["queue"] = _QUEUE
    return _common_config("router", ROUTER_NAME) | {
        "listen": {"endpoints": [f"tls/{listen}"]},
        "transport": transport,
        "access_control": router_access(site, cells),
        "downsampling": _downsampling_rules(site),
    }


def _downsampling_rules(site: str) -> list[Config]:
    """Return how often joints of a cell come in: one that floods them costs router and monitor no more than others.

    Where they come in each cell has an allowance of its own; where they leave, a rule is one for all cells together.
    """
    rule = {"key_expr": StationKeys(site, "*").joints_key, "freq": MOST_JOINTS_HZ}
    return [{"id": "joints", "flows": ["ingress"], "messages": ["put"], "rules": [rule]}]


def cell_config(site: str, cell: str, endpoint: str) -> Config:
    """Return the configuration of a cell: a peer that accepts no connections, and that opens without a router."""
    return _common_config("peer", cell) | {
        "listen": {"endpoints": []},
        "connect": {
            "endpoints": [f"tls/{endpoint}"],
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": _RETRY,
        },
        "access_control": cell_access(site, cell),
    }


def monitor_config(endpoint: str) -> Config:
    """Return the configuration of a monitor: a client, since a router forwards nothing from peer to peer."""
    return _common_config("client", MONITOR_NAME) | {
        "connect": {"endpoints": [f"tls/{endpoint}"], "timeout_ms": 2000, "retry": _RETRY},
    }


def router_access(site: str, cells: list[str]) -> Config:
    """Return the router's rules: one block per cell for what it says, one for all asking."""
    whole_site = everything_below(f"{ROOT}/{site}")
    rules = [
        _access_rule("cells-are-asked", "egress", ASKING, whole_site),
        _access_rule("monitor-asks", "ingress", ASKING, whole_site),
        _access_rule("monitor-receives", "egress", CELL_MESSAGES, whole_site),
    ]
    subjects = [_access_subject("monitor", MONITOR_NAME)]
    policies = [{"rules": ["monitor-asks", "monitor-receives"], "subjects": ["monitor"]}]
    for cell in cells:
        says = f"cell-{cell}-says"
        rules.append(
            _access_rule(says, "ingress", CELL_MESSAGES, everything_below(StationKeys(site, cell).base_key))
        )
        subjects.append(_access_subject(f"cell-{cell}", cell))
        policies.append({"rules": [says, "cells-are-asked"], "subjects": [f"cell-{cell}"]})
    return _access_control(rules, subjects, policies)


def cell_access(site: str, cell: str) -> Config:
    """Return the cell's own rules: whatever the router is made to do, nothing but questions comes in."""
    rules = [
        _access_rule("says", "egress", CELL_MESSAGES, everything_below(StationKeys(site, cell).base_key)),
        _access_rule("is-asked", "ingress", ASKING, everything_below(f"{ROOT}/{site}")),
    ]
    return _access_control(
        rules,
        [_access_subject("router", ROUTER_NAME)],
        [{"rules": ["says", "is-asked"], "subjects": ["router"]}],
    )


def _access_control(rules: list[Config], subjects: list[Config], policies: list[Config]) -> Config:
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _access_rule(name: str, flow: str, messages: list[str], keys: list[str]) -> Config:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}


def _access_subject(name: str, common_name: str) -> Config:
    return {"id": name, "cert_common_names": [common_name]}


def _common_config(mode: str, name: str) -> Config:
    return {
        "mode": mode,
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "adminspace": {"enabled": False},
        "transport": _transport_config(name),
    }


def _transport_config(name: str) -> Config:
    return {
        "shared_memory": {"enabled": False},  # on, sessions fail beyond some 350
        "link": {
            "protocols": ["tls"],
            "tx": {"lease": LEASE_MS},
            "tls": {
                "root_ca_certificate": "ca.pem",
                "enable_mtls": True,
                "listen_private_key": f"{name}.key",
                "listen_certificate": f"{name}.pem",
                "connect_private_key": f"{name}.key",
                "connect_certificate": f"{name}.pem",
                "verify_name_on_connect": True,
                "close_link_on_expiration": True,
            },
        },
    }
