"""Captures of Wireshark and tcpdump: pcap and pcapng with SocketCAN frames."""
