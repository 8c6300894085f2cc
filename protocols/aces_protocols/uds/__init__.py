"""UDS: unified diagnostic services of ECUs."""
