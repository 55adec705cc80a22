#!/usr/bin/env bash
# Tries the packages in a clean Debian: try.sh PACKAGE.deb... Needs root, debootstrap and a mirror (MIRROR, SUITE).
# Installs, asks, runs the daemon on simulated sensors, upgrades, removes, purges; nothing of it may be left.
# ROOT names a tree that is kept for another time; without it one is made and removed.
set -euo pipefail
packages=("$@")
[ ${#packages[@]} -gt 0 ] || { echo "usage: tools/debian/try.sh PACKAGE.deb..." >&2; exit 1; }
root=${ROOT:-}
if [ -z "$root" ]; then
    root=$(mktemp -d)
    trap 'rm -rf --one-file-system "$root"' EXIT
fi
if [ ! -x "$root/usr/bin/python3" ]; then
    debootstrap --variant=minbase --include=python3,man-db "${SUITE:-bookworm}" "$root" \
        "${MIRROR:-http://deb.debian.org/debian}" >/dev/null
fi
cp "${packages[@]}" "$root/tmp/"
# A process tree, mounts and a network of its own: what is started ends with it, and nobody else's ports are in the way.
inside() {
    unshare --mount --pid --fork --net --kill-child bash -c '
        mount -t proc proc "$0/proc"; mount --bind /dev "$0/dev"; ip link set lo up 2>/dev/null || true
        exec chroot "$0" /usr/bin/env -i STATE_DIRECTORY=/tmp/state PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 TERM=dumb bash -euo pipefail -c "$1"
    ' "$root" "$1"
}
files() { inside 'find / -xdev \( -path /proc -o -path /dev -o -path /tmp -o -path /var/lib/dpkg -o -path /var/cache \
    -o -path /var/log -o -path /run \) -prune -o -print | sort'; }
names=()
for package in "${packages[@]}"; do names+=("$(basename "$package")"); done
inside 'dpkg -P heaved-torch heaved >/dev/null 2>&1 || true; rm -rf /tmp/state'
before=$(files)
echo "== install"
inside "cd /tmp; dpkg -i ${names[*]}"
echo "== ask"
inside '
    heaved --version
    heaved check-config /etc/heaved/heaved.toml
    heaved manual --list | tail -n +2 | wc -l
    heaved manual reasons --search "in g"
    man --path >/dev/null; for page in "1 heaved" "5 heaved.toml" "7 heaved-reasons"; do man $page | head -n 4; done
    heaved install-service --program /opt/heaved/bin/heaved | tail -n 12
'
echo "== run"
inside '
    cd /tmp
    config=$(echo /opt/heaved/lib/python3*/site-packages/heaved/_config/sensors.toml)
    heaved sim --config "$config" >sim.log 2>&1 &
    until grep -q laser sim.log; do sleep 0.2; done
    heaved run --config "$config" >run.log 2>&1 &
    daemon=$!
    heaved wait --timeout 90
    heaved status | head -n 12
    sleep 60  # A first training is due after a minute of laser: without heaved-torch it must fail, and nothing else.
    heaved status --check || test $? = 1
    kill -TERM $daemon; wait $daemon; echo "the daemon has ended: $?"
    grep -v "fit of the sea" run.log
    test -z "$(find /opt/heaved -newer /tmp/sim.log -type f)" || { echo "something was written into the package"; exit 1; }
'
echo "== install again, remove, purge"
inside "cd /tmp; echo '# mine' >>/etc/heaved/heaved.toml; DEBIAN_FRONTEND=noninteractive dpkg --force-confold -i ${names[*]}
    tail -n 1 /etc/heaved/heaved.toml | grep -q mine
    heaved install-service --write >/dev/null || true
    dpkg -r \$(for name in ${names[*]}; do echo \${name%%_*}; done)
    test -f /etc/heaved/heaved.toml
    dpkg -P \$(for name in ${names[*]}; do echo \${name%%_*}; done)"
# dpkg takes /opt away with the last package in it.
left=$(diff <(echo "$before") <(files) | grep '^[<>]' | grep -vx '< /opt' || true)
[ -z "$left" ] || { echo "left behind, or gone:"; echo "$left"; exit 1; }
echo "nothing is left of it"
