"""Presets: choose one, see what it is for, or save the present parameters as a new one."""

from collections.abc import Callable

import viser

from app.viewer.host import Host
from app.viewer.widgets.actions import on_choice, on_press, on_press_by, on_upload
from app.viewer.widgets.html import BAD, FAINT, GOOD, paragraph

CUSTOM: str = "custom"


class PresetPanel:
    """A list of presets and a folded folder to keep one's own; callbacks must only hand on."""

    def __init__(
        self,
        host: Host,
        *,
        can_save: bool,
        on_choose: Callable[[str], None],
        on_save: Callable[[str], None],
        on_delete: Callable[[], None],
        on_download: Callable[[str, viser.ClientHandle], None],
        on_file: Callable[[str, bytes], None],
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            can_save: Whether presets can be kept on the machine that runs the viewer.
            on_choose: Given the name chosen.
            on_save: Given the name to keep the present parameters under.
            on_delete: Called to delete the preset that is shown.
            on_download: Given a name and the page that wants the present parameters as a file.
            on_file: Given the name and the content of a file.
        """
        gui = host.gui
        self._list: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Preset", (CUSTOM,), initial_value=CUSTOM, hint="A preset sets all parameters."
        )
        self._purpose = gui.add_html("")
        with gui.add_folder("Save as preset", expand_by_default=False):
            self._name = gui.add_text("Name", "", hint="Use letters, digits, spaces and . + - ( ).")
            save = gui.add_button(
                "Save preset",
                visible=can_save,
                hint="Saves the present parameters in the list, for later sessions too.",
            )
            self._delete = gui.add_button("Delete preset", visible=False, color="red")
            download = gui.add_button("Download parameters", hint="Saves a TOML file for --params.")
            upload = gui.add_upload_button(
                "Upload parameters",
                mime_type=".toml",
                hint="Loads a TOML file like those for --params.",
            )
        self._message = gui.add_html("")

        on_choice(self._list, lambda name: None if name == CUSTOM else on_choose(name))
        on_press(save, lambda: on_save(self._name.value.strip()))
        on_press(self._delete, on_delete)
        on_press_by(download, lambda page: on_download(self._name.value.strip(), page))
        on_upload(upload, on_file)

    def offer(self, names: tuple[str, ...]) -> None:
        """Fill the list."""
        self._list.options = (CUSTOM, *names)

    def show(self, name: str | None, purpose: str, *, own: bool) -> None:
        """Point at the preset that the parameters are, or at none; say what it is for."""
        self._list.value = CUSTOM if name is None else name
        self._purpose.content = paragraph(purpose, FAINT) if purpose else ""
        self._delete.visible = own

    def tell(self, message: str, *, bad: bool = False) -> None:
        """Say what came of saving, deleting or uploading."""
        colored = paragraph(message, f"color:{BAD if bad else GOOD};overflow-wrap:anywhere")
        self._message.content = f'<div data-testid="preset-message">{colored}</div>'
