"""JSON whose structure another party decides: a journal entry, a message, a project file, an answer of a worker."""

JsonValue = None | bool | int | float | str | list["JsonValue"] | dict[str, "JsonValue"]
JsonObject = dict[str, JsonValue]
