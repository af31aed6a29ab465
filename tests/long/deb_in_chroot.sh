#!/usr/bin/env bash
# Installs weft's Debian package into a new Debian 12 and folds the default shirt there: deb_in_chroot.sh FOLDER [--torch]
#
# FOLDER has the packages that `cpack -G DEB` made, after `./weft plugins`. The system is made by mmdebstrap (Debian's package; it needs root) in a
# temporary folder, from the machine's own sources of packages, and has nothing but what weft depends on. --torch installs
# weft-torch too, and trains for a moment; it downloads some 300 MB more.
# Takes minutes and the network, so it is run by hand. Exit code 0: folded; 77: mmdebstrap is not there.
set -euo pipefail
here=$(dirname -- "$(readlink -f -- "$0")")
packages=$(readlink -f -- "$1")
if ! command -v mmdebstrap >/dev/null; then
  echo "NOTHING WAS TESTED: mmdebstrap is not installed"
  exit 77
fi
debs=("$packages"/weft_*.deb)
if [[ ${2:-} == --torch ]]; then debs+=("$packages"/weft-torch_*.deb); fi

work=$(mktemp -d -t weft-deb-XXXXXX)
chmod 755 "$work"
system=$work/system
trap 'rm -rf --one-file-system "$work"' EXIT
(cd "$here" && python3 -B -c 'from container_packages import sources; print("\n".join(sources()))') |
  mmdebstrap --mode=root --variant=minbase --quiet bookworm "$system" -
# The network as this machine reaches it.
cp /etc/resolv.conf /etc/hosts "$system/etc/"
{ grep -ls Proxy /etc/apt/apt.conf.d/* || true; } | xargs -r cp -t "$system/etc/apt/apt.conf.d"
printf '#!/bin/sh\nexit 101\n' >"$system/usr/sbin/policy-rc.d"  # starts no services
chmod 755 "$system/usr/sbin/policy-rc.d"
echo force-unsafe-io >"$system/etc/dpkg/dpkg.cfg.d/unsafe"  # it is thrown away
cp "${debs[@]}" "$system/srv/"

# Runs a line in the new system, with a /proc of its own and nothing of this shell's environment.
inside() {
  unshare --mount sh -c 'mount -t proc proc "$1/proc" && exec chroot "$1" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin \
    HOME=/srv DEBIAN_FRONTEND=noninteractive /bin/bash -euc "$2"' sh "$system" "$1" </dev/null
}

echo "== install ${debs[*]##*/}"
inside 'apt-get -qq update; apt-get -qq install -y --no-install-recommends /srv/*.deb >/srv/apt.log 2>&1 || { cat /srv/apt.log; exit 1; }
  grep -c "^Setting up" /srv/apt.log; dpkg-query -W -f "\${Package} \${Version}: \${Installed-Size} kB\n" weft'
echo "== what is there"
inside 'weft --version; weft plugins | tee /srv/plugins.txt; ldd /usr/bin/weft >/srv/ldd.txt
  if grep -E "refused|not found" /srv/plugins.txt /srv/ldd.txt; then exit 1; fi
  test -s /usr/share/bash-completion/completions/weft'
echo "== fold the default shirt"
inside 'cd /srv; weft run /usr/share/weft/configs/tasks/tshirt_fold.yaml --out fold; ls fold; test -s fold/report.html
  grep -q "\"released\": true" fold/summary.json'
if [[ ${2:-} == --torch ]]; then
  echo "== train a small network"
  inside 'cd /srv; small=/usr/share/weft/configs/experiments/towel_small.yaml; weft generate $small --examples 32 --out data --quiet
    weft train $small --data data --out model.h5 --set predictor.params.training.iterations=20 --quiet; test -s model.h5; echo trained'
fi
echo "== all passed"
