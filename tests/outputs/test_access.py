"""Who may connect."""

from __future__ import annotations

import pytest

from heaved.outputs.listen import checked_networks, is_allowed, is_loopback_host, parse_networks


@pytest.mark.parametrize(
    ("address", "allow", "allowed"),
    [
        ("127.0.0.1", (), True),
        ("127.1.2.3", (), True),
        ("::1", (), True),
        ("::ffff:127.0.0.1", (), True),
        ("192.168.10.7", (), False),
        ("192.168.10.7", ("192.168.10.0/24",), True),
        ("192.168.11.7", ("192.168.10.0/24",), False),
        ("192.168.11.7", ("192.168.10.0/24", "192.168.11.7"), True),
        ("::ffff:192.168.10.7", ("192.168.10.0/24",), True),
        ("::ffff:192.168.11.7", ("192.168.10.0/24",), False),
        ("10.1.2.3", ("::ffff:10.0.0.0/104",), True),
        ("::ffff:10.1.2.3", ("::ffff:10.0.0.0/104",), True),
        ("11.1.2.3", ("::ffff:10.0.0.0/104",), False),
        ("192.168.10.7", ("::ffff:192.168.10.7",), True),
        ("8.8.8.8", ("::ffff:0:0/96",), True),
        ("8.8.8.8", ("fd00::/8",), False),
        ("fd00::1", ("fd00::/8",), True),
        ("fe80::1%eth0", ("fe80::/10",), True),
        ("fe80::1", ("192.168.10.0/24",), False),
        ("8.8.8.8", ("0.0.0.0/0",), True),
        ("", ("0.0.0.0/0",), False),
        ("/run/socket", ("0.0.0.0/0",), False),
    ],
)
def test_is_allowed(address: str, allow: tuple[str, ...], allowed: bool) -> None:
    assert is_allowed(address, parse_networks(allow)) is allowed


@pytest.mark.parametrize("entry", ["192.168.10.1/24", "crane", "", "10.0.0.0/33", "10.0.0"])
def test_an_entry_that_is_no_network_is_named(entry: str) -> None:
    with pytest.raises(ValueError, match=r"\[http\] allow: ") as raised:
        checked_networks("http", "127.0.0.1", ("10.0.0.0/8", entry))
    assert repr(entry) in str(raised.value)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2", "::1", "localhost"])
def test_loopback_needs_no_list(host: str) -> None:
    assert is_loopback_host(host)
    assert checked_networks("stream", host, ()) == ()


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.10.2", "crane-pc"])
def test_other_hosts_need_one(host: str) -> None:
    with pytest.raises(ValueError, match="name the networks that may connect"):
        checked_networks("stream", host, ())
    assert len(checked_networks("stream", host, ("192.168.10.0/24",))) == 1
