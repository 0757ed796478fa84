"""Bags of ``ros2 bag record --compression-mode``: files and messages that are packed one by one."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
import zstandard
from mcap.writer import Writer

from gray_box_observer.bag import packed
from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.limits import ReadLimits
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagOptions
from gray_box_observer.errors import BagError
from gray_box_observer.identify.archive.bag_search import find_bags
from gray_box_observer.identify.command import main

MODERATE = Path(__file__).resolve().parents[3] / 'bags' / 'moderate'
NAMES = [f'motor_{k}' for k in range(20)]


def pack_files(folder: Path) -> list[Path]:
    """Pack the files of a folder as rosbag2 does: the metadata list the old name beside the new."""
    made = []
    for path in sorted(folder.glob('*.mcap')):
        made.append(path.with_name(f'{path.name}.zstd'))
        made[-1].write_bytes(zstandard.ZstdCompressor(level=1).compress(path.read_bytes()))
        path.unlink()
    metadata = folder / 'metadata.yaml'
    text = metadata.read_text()
    names, files = text.split('  files:\n')
    names = names.replace('.mcap\n', '.mcap.zstd\n')
    names = names.replace("compression_format: ''", 'compression_format: zstd')
    metadata.write_text(
        names.replace("compression_mode: ''", 'compression_mode: FILE') + '  files:\n' + files
    )
    return made


def contents(path: Path, limits: ReadLimits | None = None) -> tuple[list[bytes], str]:
    with BagReader(path, limits) as bag:
        return [message.data for message in bag.messages()], str(bag.loss or '')


@pytest.mark.parametrize('mode', ['FILE', 'MESSAGE'])
def test_what_rosbags_packs_is_read_as_folder_and_as_file(tmp_path, mode):
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    typesys = pytest.importorskip('rosbags.typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    sent = [encode_joint_state(10**9 + k, NAMES, effort=[0.1 * k] * len(NAMES)) for k in range(200)]
    writer = rosbag2.Writer(tmp_path / 'bag', version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
    writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection('/motor/torque', TYPE_NAME, typestore=store)
        for k, data in enumerate(sent):
            writer.write(connection, 10**9 + k, data)
    assert contents(tmp_path / 'bag') == (sent, '')
    (file,) = (path for path in (tmp_path / 'bag').iterdir() if path.name != 'metadata.yaml')
    assert file.name.endswith('.zstd') == (mode == 'FILE')
    assert contents(file) == (sent, '')


def test_packed_files_are_read_in_their_order_unpacked_by_hand_and_without_metadata(make_bag):
    folder = make_bag(300, options=BagOptions(max_file_bytes=10_000))
    sent = contents(folder)
    files = pack_files(folder)
    assert len(files) > 3
    assert contents(folder) == sent
    assert find_bags([folder.parent]) == [folder]

    plain = files[0].with_suffix('')
    plain.write_bytes(zstandard.decompress(files[0].read_bytes()))
    files[0].unlink()  # as unzstd --rm leaves it
    assert contents(folder) == sent

    (folder / 'metadata.yaml').unlink()
    found, lost = contents(folder)
    assert (found, 'has no metadata.yaml' in lost) == (sent[0], True)
    files[0].write_bytes(zstandard.compress(plain.read_bytes()))  # as unzstd leaves it: both
    assert contents(folder)[0] == sent[0]
    plain.rename(folder.parent / f'{folder.name}_0.mcap')
    assert find_bags([folder.parent]) == [folder.parent / f'{folder.name}_0.mcap', folder]


@pytest.mark.slow
def test_identify_gives_the_same_numbers_of_a_packed_bag(tmp_path):
    folder = tmp_path / 'moderate'
    folder.mkdir()
    for path in MODERATE.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    pack_files(folder)
    digests = []
    for bag in (MODERATE, folder):
        assert (
            main(['identify', str(bag), '--skip-predictor', '--json', str(tmp_path / 'found.json')])
            == 0
        )
        digests.append(json.loads((tmp_path / 'found.json').read_text())['digest'])
    assert digests[0] == digests[1]


SPOILT = {
    'cut': (lambda content: content[: len(content) // 2], 'the packed file is cut'),
    'damaged': (lambda content: content[:-700] + bytes(700), 'the packed file is damaged after'),
}


@pytest.mark.parametrize(('spoil', 'complaint'), SPOILT.values(), ids=SPOILT)
def test_a_packed_file_that_is_cut_or_damaged_is_read_as_far_as_it_goes(make_bag, spoil, complaint):
    folder = make_bag(3000)
    sent, _ = contents(folder)
    (made,) = pack_files(folder)
    made.write_bytes(spoil(made.read_bytes()))
    found, lost = contents(folder)
    assert 0 < len(found) < len(sent)
    assert found == sent[: len(found)]
    assert complaint in lost


@pytest.mark.parametrize('told', [True, False])
def test_a_file_that_unpacks_to_more_than_the_limit_is_refused_with_the_remedies(tmp_path, told):
    bomb = tmp_path / 'bomb.mcap.zstd'
    compressor = zstandard.ZstdCompressor(write_content_size=told)
    bomb.write_bytes(compressor.compress(random.Random(1).randbytes(1000) * 30_000))
    limits = ReadLimits(20_000_000, 1e9, '--max-chunk-mb {}')
    with pytest.raises(
        BagError, match=rf'--max-chunk-mb \d+ reads it; or unpack it first: unzstd --rm {bomb}$'
    ):
        BagReader(bomb, limits)
    with pytest.raises(BagError, match='no recording holds 1000 times as much'):
        BagReader(bomb)


def bag_of_packed(path: Path, *messages: bytes) -> Path:
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        schema = writer.register_schema(
            TYPE_NAME, 'ros2msg', schema_text(TYPE_NAME, built_in_lookup).encode()
        )
        channel = writer.register_channel('/motor/torque', 'cdr', schema)
        for k, data in enumerate(messages):
            writer.add_message(channel, k, data, k)
        writer.finish()
    return path


def test_a_packed_message_that_lies_about_its_size_or_is_damaged_is_left_out_alone(tmp_path):
    good = encode_joint_state(1, ['motor'], effort=[1.0])
    frame = zstandard.compress(good)
    unsaid = zstandard.ZstdCompressor(write_content_size=False).compress(good)
    bomb = zstandard.compress(bytes(3_000_000))
    path = bag_of_packed(
        tmp_path / 'odd.mcap', frame, frame[:-3], unsaid, bomb, packed.MARK, good, frame
    )
    found, lost = contents(path, ReadLimits(2_000_000, 1e9))
    assert found == [good] * 3
    assert '4 packed messages that cannot be unpacked' in lost


def test_packed_messages_that_together_unpack_to_more_than_fits_are_left_out_with_the_remedy(
    tmp_path,
):
    frames = [zstandard.compress(bytes([k]) * 900_000) for k in range(10)]
    path = bag_of_packed(tmp_path / 'bombs.mcap', *frames)
    found, lost = contents(path, ReadLimits(1_000_000, 1e9, '--max-chunk-mb {}'))
    assert found == []
    assert 'its messages unpack to 9 MB; --max-chunk-mb 5 reads it' in lost
    assert contents(path, ReadLimits(5_000_000, 1e9))[1] == ''


@pytest.mark.parametrize(
    'entry', ['compression_mode: FILE\n  compression_format: bz2', 'storage_identifier: sqlite3']
)
def test_what_is_not_read_is_refused_with_the_lines_that_convert_it(make_bag, entry):
    folder = make_bag(5)
    metadata = folder / 'metadata.yaml'
    key = entry.partition(':')[0]
    lines = [
        line
        for line in metadata.read_text().splitlines()
        if key not in line and 'compression_format' not in line
    ]
    metadata.write_text('\n'.join([*lines, f'  {entry}', '']))
    with pytest.raises(BagError) as caught:
        BagReader(folder)
    assert f'; ros2 bag convert -i {folder} -o to_mcap.yaml`' in str(caught.value)
    assert "echo '{output_bags: [{uri: NEW, storage_id: mcap, all: true}]}' >to_mcap.yaml" in str(
        caught.value
    )
