"""Who may reach us over a network: this machine always, others from networks that the configuration names. Pure."""

from __future__ import annotations

import ipaddress
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

Network = ipaddress.IPv4Network | ipaddress.IPv6Network

_MAPPED: Final = ipaddress.IPv6Network("::ffff:0:0/96")
"""IPv4 addresses in IPv6 (RFC 4291, section 2.5.5.2)."""
EVERYWHERE: Final[tuple[Network, ...]] = (ipaddress.IPv4Network("0.0.0.0/0"), ipaddress.IPv6Network("::/0"))
"""All that can be reached."""


def parse_networks(entries: Iterable[str]) -> tuple[Network, ...]:
    """Networks of CIDR texts such as ``192.168.10.0/24`` (a bare address is a network of one).

    One of IPv4 addresses as IPv6 writes them (``::ffff:10.0.0.0/104``) is that of the IPv4 addresses.

    Raises:
        ValueError: names the entry and what is wrong with it.
    """
    networks = []
    for entry in entries:
        try:
            networks.append(_unmapped(ipaddress.ip_network(entry)))
        except ValueError as error:
            raise ValueError(f"allow: {entry!r} is not a network such as 192.168.10.0/24: {error}") from error
    return tuple(networks)


def _unmapped(network: Network) -> Network:
    if isinstance(network, ipaddress.IPv6Network) and network.subnet_of(_MAPPED):
        first = int(network.network_address) - int(_MAPPED.network_address)
        return ipaddress.IPv4Network((first, network.prefixlen - _MAPPED.prefixlen))
    return network


def is_allowed(address: str, networks: Iterable[Network]) -> bool:
    """Whether a peer at ``address`` may connect. Anything that is not an IP address may not."""
    try:
        peer = ipaddress.ip_address(address)
    except ValueError:
        return False
    if isinstance(peer, ipaddress.IPv6Address) and peer.ipv4_mapped is not None:
        peer = peer.ipv4_mapped  # How an IPv4 peer looks to a socket that listens on both.
    return peer.is_loopback or any(peer in network for network in networks)


def neighbourhood(address: str) -> str:
    """Under what a peer is counted: its address; of IPv6 the network of 64 bits, since a machine may give itself any
    address of it; of this machine, and of what is no IP address, nothing.
    """
    try:
        peer = ipaddress.ip_address(address)
    except ValueError:
        return ""
    if isinstance(peer, ipaddress.IPv6Address):
        if peer.ipv4_mapped is not None:
            peer = peer.ipv4_mapped
        elif not peer.is_loopback and not peer.is_link_local:  # All that are on a cable have that network.
            return str(ipaddress.IPv6Network((int(peer), 64), strict=False))
    return "" if peer.is_loopback else str(peer)


def is_loopback_host(host: str) -> bool:
    """Whether listening on ``host`` (an address or a name) stays within this machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def checked_networks(
    section: str, host: str, allow: Iterable[str], *, wants_certificates: bool = False
) -> tuple[Network, ...]:
    """The networks that may reach a server which listens on ``host``; ``section`` of the configuration. One that wants
    certificates may be reached from everywhere, unless networks are named.

    Raises:
        ValueError: an entry is not a network, or ``host`` reaches beyond this machine, no network is named and no
            certificate wanted.
    """
    try:
        networks = parse_networks(allow)
    except ValueError as error:
        raise ValueError(f"[{section}] {error}") from error
    if not networks and wants_certificates:
        return EVERYWHERE
    if not networks and not is_loopback_host(host):
        raise ValueError(
            f"[{section}] host {host} can be reached from other machines: name the networks that may connect, "
            f'for example allow = ["192.168.10.0/24"], or set host = "127.0.0.1"'
        )
    return networks
