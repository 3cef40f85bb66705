#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tries a clone of the committed tree in a bare Debian root, as a new user would: try_bare_root.sh SUITE ROOT [COMMAND...]
#
# SUITE is bookworm, trixie, ...; ROOT a directory to make the root in, or one made by an earlier call, which is then used
# as it is (its clone is replaced). Each COMMAND is one shell line run in the clone; without any: make sim, make test.
# MIRROR=url is handed to debootstrap. The host's pip settings and its own certificates are copied in, so that the root
# reaches whatever the host reaches. Needs root and debootstrap; exits with the first failing command's status.
set -euo pipefail
if (($# < 2)) || ((EUID != 0)) || ! command -v debootstrap >/dev/null; then
    echo "usage, as root, with debootstrap installed: [MIRROR=url] $0 SUITE ROOT [COMMAND...]" >&2
    exit 2
fi
suite=$1 bare=$2
shift 2
(($# > 0)) || set -- "make sim" "make test"
tree=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)

if [[ ! -e $bare/etc/debian_version ]]; then
    debootstrap --variant=minbase "$suite" "$bare" ${MIRROR:+"$MIRROR"} >"$bare.log" 2>&1 || {
        tail -n 20 "$bare.log" >&2
        exit 2
    }
fi
bare=$(cd "$bare" && pwd -P)

# /dev and /proc come and go with the private mount namespace: nothing to unmount, also after an interrupt.
if [[ -z ${DERMIS_BARE_NAMESPACE:-} ]]; then
    DERMIS_BARE_NAMESPACE=1 exec unshare --mount "$0" "$suite" "$bare" "$@"
fi
mount -t proc proc "$bare/proc"
mount --rbind /dev "$bare/dev"
mount -t tmpfs -o mode=1777 shm "$bare/dev/shm" 2>/dev/null || true

cp /etc/resolv.conf /etc/hosts "$bare/etc/"
for file in /etc/pip.conf /etc/ssl/certs/ca-certificates.crt /usr/local/share/ca-certificates/*.crt; do
    if [[ -e $file ]]; then
        mkdir -p "$bare$(dirname "$file")"
        cp "$file" "$bare$file"
    fi
done

rm -rf "$bare/opt/dermis"
git clone --quiet --no-hardlinks "$tree" "$bare/opt/dermis"

inside() {
    env -i HOME=/root LANG=C.UTF-8 TERM="${TERM:-dumb}" PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
        chroot "$bare" /bin/bash -c "cd /opt/dermis && $1"
}
# A clone and a Makefile take git and make; all else must come from the project itself.
inside "command -v make git >/dev/null || { export DEBIAN_FRONTEND=noninteractive; apt-get -qq update &&
    apt-get -qqy install --no-install-recommends make git; } >/var/log/bootstrap.log 2>&1"
for command in "$@"; do
    begin=$SECONDS status=0
    echo "== $command"
    inside "$command" || status=$?
    echo "== $command: status $status after $((SECONDS - begin)) s"
    ((status == 0)) || exit "$status"
done
