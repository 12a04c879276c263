from hypothesis import settings

# loading a compiled function for the first time takes longer than hypothesis grants one example
settings.register_profile("compiled", deadline=None)
settings.load_profile("compiled")
