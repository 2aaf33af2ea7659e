import ast


def last_text(node):
    """Return the last literal part of a text or of a formatted text; "" if there is none."""
    if isinstance(node, ast.JoinedStr):
        return last_text(node.values[-1])
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def test_errors_have_no_final_full_stop(modules):
    found = []
    for path, module in modules.items():
        for node in module.raised:
            arguments = node.exc.args if isinstance(node.exc, ast.Call) else []
            ends = [last_text(argument).strip() for argument in arguments]
            if any(end.endswith(".") and not end.endswith((" .", "...")) for end in ends):
                found.append(f"{path}:{node.lineno}")
    assert sum(len(module.raised) for module in modules.values()) > 500
    assert found == []
