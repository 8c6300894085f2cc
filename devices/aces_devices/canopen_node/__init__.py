"""What drivers and twins of CANopen nodes have in common: network, PDOs, SDO of both ends; no driver of its own."""
