"""What stays in the folder of a render when the scene is rendered again."""

from render.render_files import begin, record_of
from scenegen import IMAGE_FILES, RECORD_FILE, TRANSIENT_FILES, write_record


def test_transients_of_a_render_stay_when_only_an_image_is_damaged(tmp_path):
    folder = tmp_path / "000000"
    folder.mkdir()
    files = {}
    for name in (*TRANSIENT_FILES, *IMAGE_FILES):
        (folder / name).write_bytes(name.encode())
        files[name] = folder / name
    write_record(folder, record_of({"recipe": "a"}, files))
    (folder / IMAGE_FILES[0]).write_bytes(b"damaged")
    forget = begin(folder, "a", keeps_transients=True)
    assert not (folder / RECORD_FILE).exists()
    forget()
    assert all((folder / name).is_file() for name in TRANSIENT_FILES)
    begin(folder, "b", keeps_transients=True)()
    assert not any((folder / name).exists() for name in TRANSIENT_FILES)
