// Compiled with -march=x86-64-v4 and the instructions of AMX tiles and bfloat16 (CMakeLists.txt).
#include <immintrin.h>

#define WEFT_STRING_(x) #x
#define WEFT_STRING(x) WEFT_STRING_(x)
#define WEFT_ISA amx
#define WEFT_WIDTH 16
#define WEFT_PRODUCTS "products_amx.inc"
#include "kernels.inc"
