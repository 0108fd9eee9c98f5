// SPDX-License-Identifier: MIT
// A gauge that the firmware has on the adapter in the slot: on a PC the words of the device tree stand in
// ACPI (PRP0001), and the kernel makes of both the same client, of:N...Cti,bq34z100. S80 is QEMU's name for
// the root port at 10.0, S00 for what is plugged into it.
DefinitionBlock ("", "SSDT", 2, "GAUGES", "GAUGEFS", 1)
{
    External (\_SB.PCI0.S80.S00, DeviceObj)

    Scope (\_SB.PCI0.S80.S00)
    {
        Device (GAUG)
        {
            Name (_HID, "PRP0001")
            Name (_CRS, ResourceTemplate ()
            {
                I2cSerialBusV2 (0x55, ControllerInitiated, 100000, AddressingMode7Bit,
                    "\\_SB.PCI0.S80.S00", 0, ResourceConsumer)
            })
            Name (_DSD, Package ()
            {
                ToUUID ("daffd814-6eba-4d8c-8a91-bc9bbf4aa301"),
                Package () { Package () { "compatible", "ti,bq34z100" } }
            })
        }
    }
}
