"""What the drivers and twins of Hubo's sensor boards (`hubo_ft`, `hubo_imu`) have in common; no driver of its own."""
