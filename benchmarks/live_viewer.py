"""Subscribes to all that a live run (address: the argument) publishes until it ends; prints how many messages came."""

import json
import sys

from websockets.sync.client import connect
from websockets.typing import Subprotocol

MESSAGE_DATA = 1

messages = 0
with connect(sys.argv[1], subprotocols=[Subprotocol("foxglove.sdk.v1")]) as socket:
    for data in socket:
        if isinstance(data, bytes):
            messages += data[0] == MESSAGE_DATA
        elif (message := json.loads(data))["op"] == "advertise":
            ids = [channel["id"] for channel in message["channels"]]
            wanted = [{"id": number, "channelId": number} for number in ids]
            socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
print(messages)
