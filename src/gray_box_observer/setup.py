"""Build description of the gray_box_observer package."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = 'gray_box_observer'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', [str(path) for path in sorted(Path('config').glob('*.yaml'))]),
        (f'share/{PACKAGE}/launch', [str(path) for path in sorted(Path('launch').glob('*.launch.py'))]),
        (f'share/{PACKAGE}/layouts', [str(path) for path in sorted(Path('layouts').iterdir())]),
        (f'share/{PACKAGE}/security', [str(path) for path in sorted(Path('security').glob('*.policy.xml'))]),
    ],
    package_data={PACKAGE: ['report/*.js', 'report/*.css', 'report/*.html', 'predictor/*.safetensors']},
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
        ]
    },
)
