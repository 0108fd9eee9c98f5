include $(BR2_EXTERNAL_GAUGEFS_PATH)/package/gaugefs/gaugefs.mk
