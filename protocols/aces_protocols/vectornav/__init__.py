"""VectorNav VN-100, VN-200 and VN-300: binary output."""
