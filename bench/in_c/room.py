"""What C adds: a command, and a key of ``bench choose``."""

from bench.options import TRUSTED, Command, Option

CLOCK = Option(
    "clock", "choose", "MHz", None, "clock rate of the chip, such as 64MHz; adds its cycles to decision times"
)
CHIP = Command(
    "compare",
    "measure accuracy and cost of systems as C on a microcontroller",
    "Each fold trains, exports as bench export does, and classifies the test captures in C and in Python. "
    "The C is linked for a Cortex-M4F with 256 KiB of flash and 32 KiB of RAM. QEMU counts instructions: "
    "the mean per frame, and the costliest frame with its label. library RAM is the state of touch.c. "
    "program RAM is the whole program with 4096 bytes for heap and stack. A second table has the costs of "
    "touch_watch, if the system can watch a stream. For recordings, the emulator also watches the first "
    "minute of one. It is bench run with form=c. Needs cc, make, "
    "arm-none-eabi-gcc and qemu-system-arm (Debian: gcc make gcc-arm-none-eabi libnewlib-arm-none-eabi "
    "qemu-system-arm).",
    "bench chip data=haart protocol=loso model=reflex bits=32,8\n"
    "bench choose data=haart protocol=loso max_flash=64kB max_ram=32kB max_cycles=1M",
    makes="form",
    keys=("bits", "detector"),
    given={"form": "c"},
)
EXPORT = Command(
    "start here",
    "write a saved model as C99 for a microcontroller",
    "Writes touch.h, touch.c, tables.h and a Makefile. The C needs no heap and no library except math.h. make and "
    "make check build for this machine, make chip for a Cortex-M4F (FLASH=256K RAM=32K). make flash and make count "
    "print bytes, instructions and stack. C exists for reflex and hughes2017_cnn. It also exists for lda, softmax, "
    "bayes, svm, tree, rf, et and xgb with jung28, or with touch and model.window=. "
    f"{TRUSTED}",
    "bench fit data=haart model=reflex out=rec\nbench export rec out=rec_c bits=8\nmake -C rec_c check",
    "MODEL out=FOLDER [key=value ...]",
    "bench.in_c.command",
    options=(
        Option("bits", "export", "text", "32", "bits per stored weight; 8 uses 16 for support vectors", ("32", "8")),
        Option("out", "export", "text", "", "folder for the C files; new or empty"),
    ),
)
