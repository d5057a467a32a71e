"""A line between two machines, which is out while this process is stopped, and keeps what it was given as a real one does:

    python line.py PORT PORT_OF_THE_ROUTER
"""
import socket
import sys
import threading


def pass_on(source, to):
    try:
        while data := source.recv(65536):
            to.sendall(data)
    except OSError:
        pass
    for end in (source, to):
        try:
            end.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass


listener = socket.create_server(("127.0.0.1", int(sys.argv[1])))
print("begun", flush=True)
while True:
    client, _ = listener.accept()
    try:
        router = socket.create_connection(("127.0.0.1", int(sys.argv[2])))
    except OSError:
        client.close()
        continue
    for end in (client, router):
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for ends in ((client, router), (router, client)):
        threading.Thread(target=pass_on, args=ends, daemon=True).start()
