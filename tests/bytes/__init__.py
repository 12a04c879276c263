"""The proof that a change moves no byte: a commit before it and the working tree do the same cases, and are compared.

`make bytes` says what differs, case by case. Nothing here knows what `twin` is made of: it is driven by its command
line and by the names of docs/python.md, so that both trees are driven alike whatever became of their insides.
"""
