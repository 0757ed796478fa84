"""Build description of the gray_box_observer package."""

from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

PACKAGE = 'gray_box_observer'

# Without a C compiler the package is built all the same: numpy then learns what this would, only
# slower.
COMPILED = Extension(
    f'{PACKAGE}.context_nodes.native._compiled',
    [
        f'{PACKAGE}/context_nodes/native/{name}.c'
        for name in (
            'regular_block',
            'regular_estimate',
            'widened_estimate',
            'interval_motion',
            'whole_motor',
            'residual_filter',
            'filtered_speed',
        )
    ],
    include_dirs=[PACKAGE],
    depends=[str(path) for path in sorted(Path(PACKAGE).rglob('*.h'))],
    # Products fused with sums would make results depend on the processor; vectors are passed inside
    # one file only. With gcse and what debuggers want gcc takes three times as long, for code that
    # is no faster.
    extra_compile_args=[
        *('-O2', '-g0', '-fno-gcse', '-std=gnu11'),
        *('-ffp-contract=off', '-fno-math-errno', '-Wno-psabi'),
    ],
    libraries=['m'],
    optional=True,
)


class BuildOrNone(build_ext):
    """Builds compiled code; where that fails, no earlier build takes its place."""

    def build_extension(self, ext: Extension) -> None:
        """Build one library, or leave none: neither where it is built nor beside the sources."""
        try:
            super().build_extension(ext)
        except Exception:
            for left in (self.get_ext_fullpath(ext.name), self.get_ext_filename(ext.name)):
                Path(left).unlink(missing_ok=True)
            raise


setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(),
    ext_modules=[COMPILED],
    cmdclass={'build_ext': BuildOrNone},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', [str(path) for path in sorted(Path('config').glob('*.*ml'))]),
        (
            f'share/{PACKAGE}/launch',
            [str(path) for path in sorted(Path('launch').glob('*.launch.py'))],
        ),
        (f'share/{PACKAGE}/layouts', [str(path) for path in sorted(Path('layouts').iterdir())]),
        (
            f'share/{PACKAGE}/security',
            [str(path) for path in sorted(Path('security').glob('*.policy.xml'))],
        ),
    ],
    package_data={
        PACKAGE: [
            'report/run/*.js',
            'report/run/*.css',
            'report/run/*.html',
            'predictor/*.safetensors',
            'watching/dashboard/*.html',
            'watching/dashboard/*.js',
            'watching/dashboard/*.css',
        ]
    },
    install_requires=['setuptools', 'numpy', 'PyYAML'],
    extras_require={'archive': ['distributed', 'pyarrow'], 'test': ['pytest']},
    zip_safe=False,
    maintainer='Gray-box observer maintainers',
    maintainer_email='maintainers@gray-box-observer.example',
    description='Gray-box online observer of DC motors.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'observer = gray_box_observer.executables:observer',
            'recorder = gray_box_observer.executables:recorder',
            'player = gray_box_observer.executables:player',
            'identify = gray_box_observer.executables:identify',
            'watch = gray_box_observer.executables:watch',
            'dashboard = gray_box_observer.executables:dashboard',
        ]
    },
)
