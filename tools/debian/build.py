"""Debian packages of heaved: a virtual environment below /opt/heaved, unit, man pages, udev rule, configuration.

``heaved`` has all that runs on a ship but torch, which is as large as everything else together and which only the
trainer of the learned correction loads, in a process of its own. ``heaved-torch`` brings it into the same environment.

Wheels are taken from, or put into, ``build/deb/wheels``: with all of them there, a build needs no network. Two builds
of one commit from the same wheels give the same bytes: times are those of the commit, and nothing in a package knows
where it was built.
"""

from __future__ import annotations

import argparse
import gzip
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
HERE: Final = ROOT / "tools" / "debian"
PLACE: Final = Path("opt/heaved")
EXTRAS: Final = ("mqtt", "recording", "export", "report")
"""What a ship may want; a backtest is for the shore."""
CONFFILE: Final = "/etc/heaved/heaved.toml"
SCRIPTS: Final = ("postinst", "prerm", "postrm")
DESCRIPTION: Final = {
    "heaved": """Real-time heave and roll/pitch prediction for crane vessels
 Polls an accelerometer or IMU and a laser gauge over Modbus, estimates heave
 with its standard deviation, predicts roll and pitch, and publishes them on a
 TCP stream, in telegrams, Modbus registers, MQTT and InfluxDB.
 .
 The learned correction of the heave needs heaved-torch.""",
    "heaved-torch": """Training of the learned correction of heaved
 PyTorch for the environment of heaved in /opt/heaved. Without it all works but
 the training of the correction against a laser.""",
}


def main() -> int:
    options = _options()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    name = project["version"]
    os.environ["SOURCE_DATE_EPOCH"] = _commit_time()
    options.wheels.mkdir(parents=True, exist_ok=True)
    wanted = [*project["dependencies"], *(one for extra in EXTRAS for one in project["optional-dependencies"][extra])]
    torch = [one for one in wanted if one.startswith("torch")]
    others = [one for one in wanted if not one.startswith("torch")]
    _gather(options, others + (torch if options.with_torch else []))
    python = _python_version(options.python)
    base = options.build / "heaved"
    _environment(base, options.python, options.wheels, [*others], name)
    files = _installed(base)
    _finish(base, options.python)
    _system_files(base)
    made = [_package(base, "heaved", name, python, options.out)]
    if options.with_torch:
        whole = options.build / "heaved-torch"
        _environment(whole, options.python, options.wheels, [*others, *torch], name)
        for file in sorted(files & _installed(whole)):
            (whole / file).unlink()
        _finish(whole, options.python)
        made.append(_package(whole, "heaved-torch", name, python, options.out))
    for path in made:
        print(f"{path} ({path.stat().st_size / 1e6:.0f} MB)")
    return 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="tools/deb", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--with-torch", action="store_true", help="make heaved-torch, too")
    parser.add_argument(
        "--python", type=Path, default=Path("/usr/bin/python3"), help="Debian's, of the release that it is for"
    )
    parser.add_argument("--build", type=Path, default=ROOT / "build" / "deb", help="where it is put together")
    parser.add_argument("--wheels", type=Path, help="default: wheels in --build")
    parser.add_argument("--offline", action="store_true", help="take nothing that is not in --wheels")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="where the packages go")
    options = parser.parse_args()
    options.build, options.out = options.build.resolve(), options.out.resolve()
    options.wheels = (options.wheels or options.build / "wheels").resolve()
    return options


def _run(*words: str | Path, **more: str) -> str:
    done = subprocess.run(list(map(str, words)), check=False, text=True, stdout=subprocess.PIPE, env=os.environ | more)
    if done.returncode:
        sys.exit(f"tools/deb: failed: {' '.join(map(str, words))}\n{done.stdout}")
    return done.stdout


def _commit_time() -> str:
    given = os.environ.get("SOURCE_DATE_EPOCH")
    return given or _run("git", "-C", ROOT, "log", "-1", "--format=%ct").strip()


def _python_version(python: Path) -> tuple[int, int]:
    major, minor = _run(python, "-c", "import sys; print(*sys.version_info[:2])").split()
    return int(major), int(minor)


def _pip(*words: str | Path) -> None:
    _run(sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *words)


def _gather(options: argparse.Namespace, requirements: list[str]) -> None:
    """Every wheel into one directory: that of heaved anew, the others as far as they are not there."""
    for old in options.wheels.glob("heaved-*.whl"):
        old.unlink()
    _pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", options.wheels, ROOT)
    if options.offline:
        return
    major, minor = _python_version(options.python)
    _pip(
        "download", "--only-binary=:all:", f"--python-version={major}.{minor}", "--dest", options.wheels,
        "--find-links", options.wheels, *requirements,
    )  # fmt: skip


def _environment(base: Path, python: Path, wheels: Path, requirements: list[str], version: str) -> None:
    """An environment below ``base`` that works below the root, and knows nothing of where it was made."""
    shutil.rmtree(base, ignore_errors=True)
    place = base / PLACE
    _run(python, "-m", "venv", "--without-pip", place)
    # The wheel of heaved says that it needs torch, which is in a package of its own.
    for words in (requirements, ["--no-deps", f"heaved=={version}"]):
        _pip("--python", place / "bin/python", "install", "--no-compile", "--no-index", "--find-links", wheels, *words)
    for script in (place / "bin").iterdir():
        if script.name.lower().startswith("activate"):
            script.unlink()
        elif not script.is_symlink():
            script.write_text(script.read_text().replace(str(place), f"/{PLACE}"))
    settings = place / "pyvenv.cfg"
    settings.write_text(
        "".join(line for line in settings.read_text().splitlines(True) if not line.startswith("command"))
    )


def _installed(base: Path) -> set[Path]:
    return {path.relative_to(base) for path in base.rglob("*") if path.is_file() or path.is_symlink()}


def _finish(base: Path, python: Path) -> None:
    """Compiled, since the service may not write there; and without a trace of ``base``."""
    packages = next((base / PLACE / "lib").glob("python*")) / "site-packages"
    compiler = (python, "-m", "compileall", "-q", "-s", base, "-p", "/", "--invalidation-mode", "unchecked-hash")
    # Files for newer releases of Python, which some packages have among their tests, cannot be: they stay as they are.
    subprocess.run([*map(str, compiler), str(packages)], check=False, stdout=subprocess.DEVNULL)
    if (packages / "heaved").is_dir():
        _run(*compiler, "-f", packages / "heaved")
    traces = _run("bash", "-c", 'grep -rlF --binary-files=text -- "$0" "$0" || true', base)
    if traces:
        sys.exit(f"tools/deb: these know where they were made:\n{traces}")
    for directory, _, _ in os.walk(base, topdown=False):
        if not any(Path(directory).iterdir()):
            Path(directory).rmdir()


def _system_files(base: Path) -> None:
    """What lies elsewhere: unit, rule, configuration, command, man pages, licence."""
    _put(base, "usr/lib/systemd/system/heaved.service", (ROOT / "systemd/heaved.service").read_bytes())
    _put(base, "usr/lib/udev/rules.d/70-heaved-latency.rules", (HERE / "70-heaved-latency.rules").read_bytes())
    _put(base, CONFFILE.lstrip("/"), (ROOT / "config/heaved.toml").read_bytes())
    (base / "usr/bin").mkdir(parents=True)
    (base / "usr/bin/heaved").symlink_to(f"/{PLACE}/bin/heaved")
    manual = base / "usr/share/man"
    # Imported from the package itself, which must not be compiled by that into its own time.
    _run(
        base / PLACE / "bin/python",
        "-P",
        ROOT / "tools/man_pages.py",
        manual,
        PYTHONDONTWRITEBYTECODE="1",
        PYTHONPATH="",
    )
    for page in sorted(manual.rglob("*.[1-9]")):
        page.with_name(f"{page.name}.gz").write_bytes(gzip.compress(page.read_bytes(), mtime=0))
        page.unlink()


def _put(base: Path, name: str, content: bytes) -> None:
    path = base / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def _package(base: Path, name: str, version: str, python: tuple[int, int], out: Path) -> Path:
    """The package of what is below ``base``."""
    documents = f"usr/share/doc/{name}"
    date = _run("date", "-uR", "-d", f"@{os.environ['SOURCE_DATE_EPOCH']}").strip()
    maintainer = "The heaved developers <heaved@localhost>"
    history = (
        f"{name} ({version}) stable; urgency=medium\n\n  * See CHANGELOG.md of heaved.\n\n -- {maintainer}  {date}\n"
    )
    _put(base, f"{documents}/changelog.gz", gzip.compress(history.encode(), mtime=0))
    _put(
        base,
        f"{documents}/copyright",
        b"heaved is licensed under the Apache License 2.0: /usr/share/common-licenses/Apache-2.0\n\n"
        b"The packages beside it in /opt/heaved/lib have licences of their own, in their *.dist-info directories.\n",
    )
    major, minor = python
    depends = f"python3 (>= {major}.{minor}), python3 (<< {major}.{minor + 1})"
    architecture = _run("dpkg", "--print-architecture").strip()
    size_kb = sum(path.lstat().st_size for path in base.rglob("*")) // 1024
    control = [
        f"Package: {name}", f"Version: {version}", f"Architecture: {architecture}", f"Maintainer: {maintainer}",
        f"Installed-Size: {size_kb}", "Section: science", "Priority: optional",
    ]  # fmt: skip
    if name == "heaved":
        # Numerical libraries bring their own; of the system they take the C and C++ libraries.
        control += [
            f"Depends: {depends}, libc6, libstdc++6, libgcc-s1",
            "Recommends: heaved-torch, udev",
            "Suggests: man-db",
        ]
    else:
        control += [f"Depends: {depends}, heaved (= {version})"]
    control += [f"Description: {DESCRIPTION[name]}"]
    _put(base, "DEBIAN/control", ("\n".join(control) + "\n").encode())
    if name == "heaved":
        _put(base, "DEBIAN/conffiles", f"{CONFFILE}\n".encode())
        for script in SCRIPTS:
            shutil.copyfile(HERE / f"heaved.{script}", base / "DEBIAN" / script)
    sums = _run(
        "bash",
        "-c",
        'cd "$0" && find . -type f ! -path "./DEBIAN/*" -printf "%P\\0" | LC_ALL=C sort -z | xargs -0 md5sum',
        base,
    )
    _put(base, "DEBIAN/md5sums", sums.encode())
    _settle(base)
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{name}_{version}_{architecture}.deb"
    # One thread: what several write depends on how many there were.
    _run("dpkg-deb", "--root-owner-group", "-Zxz", "-z2", "--threads-max=1", "--build", base, path)
    return path


def _settle(base: Path) -> None:
    """Modes and times that do not depend on who builds when."""
    made_s = int(os.environ["SOURCE_DATE_EPOCH"])
    for path in (base, *base.rglob("*")):
        if not path.is_symlink():
            runs = (
                path.is_dir() or path.stat().st_mode & 0o100 or (path.parent.name == "DEBIAN" and path.name in SCRIPTS)
            )
            # Wheels have their libraries as programs, which they are not.
            path.chmod(0o755 if runs and (path.is_dir() or ".so" not in path.name) else 0o644)
        os.utime(path, (made_s, made_s), follow_symlinks=False)


if __name__ == "__main__":
    sys.exit(main())
