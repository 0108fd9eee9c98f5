# SPDX-License-Identifier: MIT

SUMMARY = "Mounts TI battery fuel gauges as a Linux power_supply tree, data flash included"
HOMEPAGE = "https://github.com/gaugefs/gaugefs"
LICENSE = "MIT"
LIC_FILES_CHKSUM = "file://LICENSES/MIT.txt;md5=344b08b535773c6a691d07e70f67ebb7"

# `bitbake -c update_crates gaugefs` writes the list of crates beside this file, with their checksums.
SRC_URI = "crate://crates.io/gaugefs/${PV}"
include ${BPN}-crates.inc

inherit cargo cargo-update-recipe-crates systemd update-rc.d useradd

# The commands that draw and watch are a third of the program.
PACKAGECONFIG ??= "screen rescue"
PACKAGECONFIG[screen] = "--features screen"
PACKAGECONFIG[rescue] = "--features rescue"
# The program of a production line.
PACKAGECONFIG[station] = "--bin gaugefs-station"
# What is installed for good; `release` compiles quickly.
CARGO_PROFILE = "dist"
CARGO_BUILD_FLAGS += "--no-default-features --bin gaugefs"

do_install:append() {
    install -d ${D}${sysconfdir}/gaugefs
    install -d -m 0700 ${D}${localstatedir}/lib/gaugefs
    if ${@bb.utils.contains('DISTRO_FEATURES', 'systemd', 'true', 'false', d)}; then
        for unit in gaugefs gaugefs@ gaugefs-node@; do
            install -D -m 0644 ${S}/udev/$unit.service ${D}${systemd_system_unitdir}/$unit.service
            install -D -m 0644 ${S}/udev/service.conf ${D}${systemd_system_unitdir}/$unit.service.d/10-confined.conf
        done
        install -D -m 0644 ${S}/udev/60-gaugefs.rules ${D}${nonarch_base_libdir}/udev/rules.d/60-gaugefs.rules
        install -D -m 0644 ${S}/udev/modules-load.conf ${D}${nonarch_libdir}/modules-load.d/gaugefs.conf
        chown gaugefs:gaugefs ${D}${localstatedir}/lib/gaugefs
    else
        install -D -m 0755 ${S}/udev/S60gaugefs ${D}${sysconfdir}/init.d/gaugefs
    fi
}

FILES:${PN} += "${systemd_system_unitdir} ${nonarch_base_libdir}/udev ${nonarch_libdir}/modules-load.d"
SYSTEMD_SERVICE:${PN} = "gaugefs.service"
INITSCRIPT_NAME = "gaugefs"
INITSCRIPT_PARAMS = "defaults 60"

USERADD_PACKAGES = "${PN}"
GROUPADD_PARAM:${PN} = "--system i2c"
USERADD_PARAM:${PN} = "--system --home-dir ${localstatedir}/lib/gaugefs --no-create-home --shell /sbin/nologin --groups i2c --user-group gaugefs"

# fusermount3, for users other than root, is of the recipe fuse3.
RRECOMMENDS:${PN} = "kernel-module-fuse kernel-module-i2c-dev"
# The units enter the namespace in which everybody sees the mount.
RDEPENDS:${PN} = "${@bb.utils.contains('DISTRO_FEATURES', 'systemd', 'util-linux-nsenter', '', d)}"
RSUGGESTS:${PN} = "fuse3-utils"
