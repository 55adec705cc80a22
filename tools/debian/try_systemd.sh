#!/usr/bin/env bash
# Tries the service under a running systemd: try_systemd.sh HEAVED.deb [HEAVED-TORCH.deb]. Needs root, debootstrap, a
# mirror, cgroup v2.
# A clean Debian is booted in namespaces of its own. The daemon reads simulated sensors there, first at an address that
# the unit does not allow, then after heaved install-service; it records, is reloaded, killed, hung, stopped and removed.
# What the unit takes away is tried under the unit's own restrictions; with the second package a network is trained there.
# ROOT names a tree that is kept for another time; without it one is made and removed.
set -euo pipefail
package=${1:?usage: tools/debian/try_systemd.sh HEAVED.deb [HEAVED-TORCH.deb]}
root=${ROOT:-}
if [ -z "$root" ]; then
    root=$(mktemp -d)
    chmod 755 "$root"  # It is the root of a system whose services are not run by root.
    trap 'rm -rf --one-file-system "$root"' EXIT
fi
if [ ! -x "$root/sbin/init" ]; then
    debootstrap --variant=minbase --include=systemd,systemd-sysv,dbus,udev,python3,iproute2 "${SUITE:-bookworm}" "$root" \
        "${MIRROR:-http://deb.debian.org/debian}" >/dev/null
fi
rm -f "$root"/heaved*.deb
cp "$package" "$root/heaved.deb"
[ -z "${2:-}" ] || cp "$2" "$root/heaved-torch.deb"
cat >"$root/etc/systemd/system/trial.service" <<'UNIT'
[Unit]
Description=The trial
After=basic.target
[Service]
Type=oneshot
ExecStart=/bin/bash -c "bash /trial.sh >/trial.log 2>&1"
ExecStopPost=/bin/systemctl --no-block poweroff
UNIT
cat >"$root/etc/systemd/system/sensors.service" <<'UNIT'
[Service]
ExecStart=/usr/bin/heaved sim --config /etc/heaved/heaved.toml
StandardOutput=null
UNIT
mkdir -p "$root/etc/systemd/system/multi-user.target.wants"
ln -sf ../trial.service "$root/etc/systemd/system/multi-user.target.wants/trial.service"
cat >"$root/trial.sh" <<'TRIAL'
set -euo pipefail
trap 'echo "FAILED in line $LINENO"; log | tail -n 20' ERR
export PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8
began=$(date +%s)
log() { journalctl -u heaved --no-pager --since "@$began"; }
export began && export -f log
say() { echo "== $*"; }
device() { heaved status --json | python3 -c 'import json, sys; print([d["up"] for d in json.load(sys.stdin)["status"]["devices"]])'; }
until_true() { for _ in $(seq 100); do if "$@"; then return; fi; sleep 0.2; done; echo "never: $*"; return 1; }
all_up() { [ "$(device)" = "[True, True]" ]; }

say "install"
dpkg -P heaved-torch heaved >/dev/null 2>&1 || true
dpkg -i /heaved.deb >/dev/null
! systemctl is-active --quiet heaved
! systemctl is-enabled --quiet heaved
ip addr add 10.9.9.1/32 dev lo  # No loopback address: the unit forbids it.
sed 's#tcp://127.0.0.1:#tcp://10.9.9.1:#' /opt/heaved/lib/python3*/site-packages/heaved/_config/sensors.toml >/etc/heaved/heaved.toml
printf '\n[recording]\nenabled = true\n' >>/etc/heaved/heaved.toml
systemctl start sensors
until_true sh -c 'ss -Hltn | grep -q 10.9.9.1:15021'

say "sensors at an address that the unit does not allow"
systemctl start heaved
sleep 3
[ "$(device)" = "[False, False]" ]
log | grep -m 1 -e "not permitted to talk to 10.9.9.1" -e "nobody answers the connection"

say "heaved install-service"
heaved install-service --write
systemctl restart heaved
until_true all_up
heaved wait --timeout 120
heaved status --check || test $? = 1
heaved status | head -n 3

say "who it is"
pid=$(systemctl show --value -p MainPID heaved)
stat -c '%U' "/proc/$pid" && grep -E '^(Cap(Eff|Bnd)|NoNewPrivs|Seccomp):' "/proc/$pid/status"
systemctl show -p ActiveState -p NRestarts -p StatusText -p WatchdogUSec heaved
nsenter --target "$pid" --mount -- ls -ld /var/lib/heaved/ /root /home 2>&1 || true

say "what the unit takes away"
exposure=$(systemd-analyze security --no-pager heaved | sed -n 's/.*Overall exposure level for heaved.service: \([0-9.]*\).*/\1/p')
echo "exposure $exposure"
python3 -c "import sys; raise SystemExit(not 0.0 < float(sys.argv[1]) <= 1.3)" "$exposure"
cat >/usr/lib/heaved-forbidden.py <<'PYTHON'
import ctypes, mmap, os, signal, socket, time

libc = ctypes.CDLL(None, use_errno=True)


def called(result):
    if result == -1:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def write(path):
    with open(path, "a") as file:
        file.write("x")


def execute_what_was_written():
    mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)


def talk(address):
    with socket.create_connection(address, 1.0):
        pass


def others():
    if [one for one in os.listdir("/proc") if one.isdigit() and os.stat(f"/proc/{one}").st_uid != os.getuid()]:
        return
    raise PermissionError("none are seen")


FORBIDDEN = {
    "write into /usr": lambda: write("/usr/lib/mark"),
    "write into /etc": lambda: write("/etc/heaved/heaved.toml"),
    "write into /var/lib": lambda: write("/var/lib/mark"),
    "write into /boot": lambda: write("/boot/mark"),
    "read /root": lambda: os.listdir("/root"),
    "read the shadow": lambda: open("/etc/shadow").read(),
    "read the kernel's log": lambda: open("/dev/kmsg").read(1),
    "write into /sys": lambda: write("/sys/kernel/mm/ksm/run"),
    "set a kernel parameter": lambda: write("/proc/sys/kernel/hostname"),
    "set the host's name": lambda: called(libc.sethostname(b"x", 1)),
    "set the clock": lambda: time.clock_settime(time.CLOCK_REALTIME, time.time()),
    "mount": lambda: called(libc.mount(b"none", b"/tmp", b"tmpfs", 0, None)),
    "a namespace of its own": lambda: called(libc.unshare(0x10000000)),
    "another user": lambda: os.setuid(0),
    "memory that is written and run": execute_what_was_written,
    "a raw socket": lambda: socket.socket(socket.AF_PACKET, socket.SOCK_RAW),
    "netlink": lambda: socket.socket(socket.AF_NETLINK, socket.SOCK_RAW),
    "real-time scheduling": lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10)),
    "trace the first process": lambda: called(libc.ptrace(16, 1, 0, 0)),
    "end the first process": lambda: os.kill(1, signal.SIGTERM),
    "see the processes of others": others,
    "an address that is not named": lambda: talk(("10.9.9.2", 9)),
    "a file that runs as its owner": lambda: os.chmod(os.open("/tmp/x", os.O_CREAT | os.O_RDWR), 0o4755) or os.stat("/tmp/x"),
}
able = []
for what, attempt in FORBIDDEN.items():
    try:
        attempt()
    except (OSError, TimeoutError) as error:
        # Nobody listens at the address: to be refused there would mean to have been let out.
        if isinstance(error, ConnectionRefusedError):
            able.append(what)
    else:
        able.append(what)
with open(os.path.join(os.environ["STATE_DIRECTORY"], "mark"), "w") as file:
    file.write("its own state")
os.unlink(file.name)
print(len(FORBIDDEN) - len(able), "of", len(FORBIDDEN), "are refused;", "able to:", able or "nothing else")
raise SystemExit(bool(able))
PYTHON
ip addr add 10.9.9.2/32 dev lo
sed -e 's#^ExecStart=.*#ExecStart=/opt/heaved/bin/python /usr/lib/heaved-forbidden.py#' -e 's/^Type=notify/Type=oneshot/' \
    -e '/^\(Restart\|Watchdog\|NotifyAccess\|ExecReload\)/d' /usr/lib/systemd/system/heaved.service >/etc/systemd/system/forbidden.service
systemctl daemon-reload
systemctl start forbidden || { journalctl -u forbidden --no-pager --since "@$began" | tail -n 5; false; }
journalctl -u forbidden --no-pager --since "@$began" | grep -m 1 "are refused"
rm /etc/systemd/system/forbidden.service /usr/lib/heaved-forbidden.py
systemctl daemon-reload

say "reload, kill, hang, stop"
systemctl reload heaved
until_true bash -c 'log | grep -q "configuration read again"'
kill -KILL "$pid"
until_true sh -c "test \$(systemctl show --value -p MainPID heaved) != $pid && systemctl is-active --quiet heaved"
until_true all_up
# A loop that hangs feeds no watchdog: it is ended within the watchdog's time and that of an end, and started again.
pid=$(systemctl show --value -p MainPID heaved)
start=$(date +%s%N)
kill -STOP "$pid"
until_true sh -c "test \$(systemctl show --value -p MainPID heaved) != $pid && systemctl is-active --quiet heaved"
until_true all_up
echo "a hung loop was back within $((($(date +%s%N) - start) / 1000000)) ms"
log | grep -m 1 -i "watchdog timeout"
test -s /var/lib/private/heaved/state.json
start=$(date +%s%N)
systemctl stop heaved
! log | grep "has failed"
echo "stopped within $((($(date +%s%N) - start) / 1000000)) ms"
test -s /var/lib/private/heaved/state.json
find /var/lib/private/heaved/recordings -type f

say "a warm start"
systemctl start heaved
heaved wait --timeout 120
log | grep -m 1 "state restored"

if [ -e /heaved-torch.deb ]; then
    say "a training under the restrictions of the unit"
    systemctl stop heaved
    dpkg -i /heaved-torch.deb >/dev/null
    cat >/usr/lib/heaved-training.py <<'PYTHON'
import numpy as np
from heaved.samples import TrainingWindow
from heaved.workers.process import BlockingTrainer

rows = np.random.default_rng(1).normal(size=(1200, 50))
window = TrainingWindow(number=1, inputs=rows.tobytes(), targets=(0.3 * rows[:, 7]).tobytes(), rows=1200, width=50,
                        hidden=10, learning_rate=0.01, epochs=1000, output="linear", seed=1)
with BlockingTrainer() as trainer:
    trained = trainer.fit(window)
print("trained within", trained.seconds, "s", trained.message)
raise SystemExit(bool(trained.message))
PYTHON
    sed -e 's#^ExecStart=.*#ExecStart=/opt/heaved/bin/python /usr/lib/heaved-training.py#' -e 's/^Type=notify/Type=oneshot/' \
        -e '/^\(Restart\|Watchdog\|NotifyAccess\|ExecReload\)/d' -e 's/^TimeoutStartSec=.*/TimeoutStartSec=120s/' \
        /usr/lib/systemd/system/heaved.service >/etc/systemd/system/training.service
    systemctl daemon-reload
    systemctl start training
    journalctl -u training --no-pager --since "@$began" | grep -m 1 "trained within"
    rm /etc/systemd/system/training.service /usr/lib/heaved-training.py
    dpkg -P heaved-torch >/dev/null
    systemctl start heaved
fi

say "remove, purge"
systemctl stop sensors
systemctl enable heaved 2>/dev/null
dpkg -r heaved >/dev/null
! systemctl is-active --quiet heaved
dpkg -P heaved >/dev/null
left=$(find / -xdev -path /proc -prune -o -path /sys -prune -o -iname '*heaved*' -print | grep -Ev '^/(heaved[^/]*$|var/(log|lib/dpkg))' || true)
[ -z "$left" ] || { echo "left behind: $left"; false; }
say "all well"
TRIAL
cgroup=$(awk '$3 == "cgroup2" { print $2; exit }' /proc/mounts)/heaved-trial
mkdir -p "$cgroup"
(
    echo "$BASHPID" >"$cgroup/cgroup.procs"
    exec timeout --signal=KILL "${SECONDS_AT_MOST:-400}" \
        unshare --mount --pid --fork --net --uts --ipc --cgroup --kill-child bash -euc '
        cd "$0"
        mount --make-rprivate / && mount --bind . . && cd "$0"
        mount -t proc proc proc && mount -t sysfs sysfs sys && mount -t cgroup2 cgroup2 sys/fs/cgroup
        mount -t tmpfs tmpfs run && mount -t tmpfs -o mode=755 dev dev
        for node in null zero full random urandom tty; do cp -a /dev/$node dev/; done
        mkdir dev/pts dev/shm && mount -t devpts -o newinstance,ptmxmode=666 devpts dev/pts && ln -s pts/ptmx dev/ptmx
        ip link set lo up
        mkdir -p mnt/old && pivot_root . mnt/old && umount -l /mnt/old
        exec env -i container=lxc PATH=/usr/sbin:/usr/bin:/sbin:/bin /sbin/init
    ' "$root"
) </dev/null >/dev/null 2>&1 || true
rmdir "$cgroup" 2>/dev/null || true
cat "$root/trial.log"
tail -n 1 "$root/trial.log" | grep -qx "== all well"
