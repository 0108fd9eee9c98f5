################################################################################
#
# gaugefs
#
################################################################################

GAUGEFS_VERSION = 0.1.0
GAUGEFS_SITE = $(call github,gaugefs,gaugefs,v$(GAUGEFS_VERSION))
GAUGEFS_LICENSE = MIT
GAUGEFS_LICENSE_FILES = LICENSES/MIT.txt
GAUGEFS_CARGO_OPTS = --no-default-features --bin gaugefs
# Size counts; Buildroot sets the optimisation of release builds itself.
GAUGEFS_CARGO_ENV = CARGO_PROFILE_RELEASE_LTO=true CARGO_PROFILE_RELEASE_CODEGEN_UNITS=1

ifeq ($(BR2_PACKAGE_GAUGEFS_SCREEN),y)
GAUGEFS_CARGO_OPTS += --features screen
endif
ifeq ($(BR2_PACKAGE_GAUGEFS_RESCUE),y)
GAUGEFS_CARGO_OPTS += --features rescue
endif
ifeq ($(BR2_PACKAGE_GAUGEFS_STATION),y)
GAUGEFS_CARGO_OPTS += --bin gaugefs-station
endif
GAUGEFS_CARGO_BUILD_OPTS = $(GAUGEFS_CARGO_OPTS)
GAUGEFS_CARGO_INSTALL_OPTS = $(GAUGEFS_CARGO_OPTS)

define GAUGEFS_INSTALL_DIRS
	$(INSTALL) -d -m 0755 $(TARGET_DIR)/etc/gaugefs
	$(INSTALL) -d -m 0700 $(TARGET_DIR)/var/lib/gaugefs
endef
GAUGEFS_POST_INSTALL_TARGET_HOOKS += GAUGEFS_INSTALL_DIRS

define GAUGEFS_INSTALL_INIT_SYSV
	$(INSTALL) -D -m 0755 $(@D)/udev/S60gaugefs $(TARGET_DIR)/etc/init.d/S60gaugefs
endef

define GAUGEFS_INSTALL_INIT_OPENRC
	$(INSTALL) -D -m 0755 $(@D)/udev/gaugefs.openrc $(TARGET_DIR)/etc/init.d/gaugefs
endef

# With systemd it runs under an account of its own, to which the rule hands the buses.
define GAUGEFS_USERS
	gaugefs -1 gaugefs -1 * - - i2c Fuel gauges
endef

define GAUGEFS_INSTALL_INIT_SYSTEMD
	$(foreach unit,gaugefs gaugefs@ gaugefs-node@, \
		$(INSTALL) -D -m 0644 $(@D)/udev/$(unit).service \
			$(TARGET_DIR)/usr/lib/systemd/system/$(unit).service
		$(INSTALL) -D -m 0644 $(@D)/udev/service.conf \
			$(TARGET_DIR)/usr/lib/systemd/system/$(unit).service.d/10-confined.conf
	)
	$(INSTALL) -D -m 0644 $(@D)/udev/60-gaugefs.rules $(TARGET_DIR)/usr/lib/udev/rules.d/60-gaugefs.rules
	$(INSTALL) -D -m 0644 $(@D)/udev/modules-load.conf $(TARGET_DIR)/usr/lib/modules-load.d/gaugefs.conf
endef

define GAUGEFS_LINUX_CONFIG_FIXUPS
	$(call KCONFIG_ENABLE_OPT,CONFIG_FUSE_FS)
	$(call KCONFIG_ENABLE_OPT,CONFIG_I2C)
	$(call KCONFIG_ENABLE_OPT,CONFIG_I2C_CHARDEV)
endef

$(eval $(cargo-package))
