"""Build description of the dc_motor_sim package."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = 'dc_motor_sim'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', [str(path) for path in Path('config').glob('*.yaml')]),
        (f'share/{PACKAGE}/launch', [str(path) for path in Path('launch').glob('*.launch.py')]),
        (
            f'share/{PACKAGE}/security',
            [str(path) for path in Path('security').glob('*.policy.xml')],
        ),
    ],
    install_requires=['setuptools', 'numpy'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='Gray-box observer maintainers',
    maintainer_email='maintainers@gray-box-observer.example',
    description='Simulated DC motors that publish armature voltage and torque.',
    license='Apache-2.0',
    entry_points={'console_scripts': ['motor_sim = dc_motor_sim.executables:motor_sim']},
)
