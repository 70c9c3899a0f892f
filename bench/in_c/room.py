"""What C adds: a command, and a key of ``bench choose``."""

from bench.options import TRUSTED, Command, Option

CLOCK = Option(
    "clock",
    "MHz",
    None,
    "clock rate of the chip, such as 64MHz; adds its cycles to decision times",
    commands="choose",
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
    module="bench.in_c.command",
    options=(
        Option("bits", "text", "32", "bits per stored weight; 8 uses 16 for support vectors", ("32", "8")),
        Option("out", "text", "", "folder for the C files; new or empty"),
    ),
)
