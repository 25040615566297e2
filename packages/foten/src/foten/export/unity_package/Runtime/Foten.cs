using System;
using System.Runtime.InteropServices;
using System.Text;

namespace Foten
{
    /// <summary>A file that cannot be rendered; the message is one line for people.</summary>
    public sealed class FotenException : Exception
    {
        public FotenException(string message) : base(message) { }
    }

    /// <summary>A texture file made ready; any number of renderers may share it.</summary>
    public sealed class Texture : IDisposable
    {
        private IntPtr pointer;

        internal IntPtr Pointer => pointer != IntPtr.Zero ? pointer : throw new ObjectDisposedException(nameof(Texture));

        public string Name { get; }
        public string Model { get; }
        /// <summary>Its own rate [Hz].</summary>
        public double Rate { get; }
        /// <summary>Standard deviation of the recorded acceleration [m/s²].</summary>
        public double AccelerationSd { get; }
        /// <summary>What it was recorded at: mm/s and N. Below it fades; above, its level grows or is held.</summary>
        public double LowestSpeed { get; }
        public double HighestSpeed { get; }
        public double LightestForce { get; }
        public double HeaviestForce { get; }

        public Texture(byte[] file)
        {
            if (Native.foten_abi() != Native.Abi) throw new FotenException("the foten library is of another version than Foten.cs");
            var why = new byte[256];
            int status = Native.foten_model_load(file, (UIntPtr)file.Length, out IntPtr model, why, (UIntPtr)why.Length);
            if (status != 0) throw new FotenException(Encoding.UTF8.GetString(why, 0, Math.Max(0, Array.IndexOf(why, (byte)0))));
            pointer = model;
            Native.Info info = Native.foten_model_info(model);
            Name = Text(info.texture);
            Model = Text(info.model);
            Rate = info.rate_hz;
            AccelerationSd = info.acceleration_sd;
            LowestSpeed = info.speed_low;
            HighestSpeed = info.speed_high;
            LightestForce = info.force_low;
            HeaviestForce = info.force_high;
        }

        private static string Text(IntPtr utf8)
        {
            int n = 0;
            while (Marshal.ReadByte(utf8, n) != 0) n++;
            var bytes = new byte[n];
            Marshal.Copy(utf8, bytes, 0, n);
            return Encoding.UTF8.GetString(bytes);
        }

        /// <summary>After its renderers.</summary>
        public void Dispose()
        {
            Native.foten_model_free(pointer); // NULL is nothing
            pointer = IntPtr.Zero;
        }
    }

    /// <summary>One rendering of a texture. All but <see cref="SetCondition"/> belongs to one thread at a time, <see cref="Dispose"/> too.</summary>
    public sealed class Renderer : IDisposable
    {
        private readonly Texture texture; // the state needs it as long as it lives
        private IntPtr pointer;

        private IntPtr State => pointer != IntPtr.Zero ? pointer : throw new ObjectDisposedException(nameof(Renderer));

        /// <param name="rate">Of the output [Hz]; 0 for the texture's own.</param>
        /// <param name="smooth">Puts conditions through the low-pass of the recordings: for those that are set once a frame.</param>
        public Renderer(Texture texture, double rate = 0, ulong seed = 0, ulong stream = 0, bool excitation = true, bool smooth = false)
        {
            this.texture = texture;
            var options = new Native.Options { rate_hz = rate, seed = seed, stream = stream, deterministic = excitation ? 0 : 1, smooth = smooth ? 1 : 0 };
            pointer = Native.foten_state_new(texture.Pointer, ref options);
            if (pointer == IntPtr.Zero) throw new FotenException($"a rate of {rate} Hz cannot be rendered of a texture of {texture.Rate} Hz");
        }

        /// <summary>Set speed and force: mm/s and N.</summary>
        public void SetCondition(float speed, float force) => Native.foten_set_condition(State, speed, force);

        /// <summary>Fill an array with the next samples [m/s²].</summary>
        public void Render(float[] samples) => Render(samples, samples.Length);

        /// <summary>Fill the first n of an array.</summary>
        public void Render(float[] samples, int n)
        {
            if (n < 0 || n > samples.Length) throw new ArgumentOutOfRangeException(nameof(n));
            Native.foten_render(State, samples, (UIntPtr)n);
        }

        public void Reset(ulong seed) => Native.foten_reset(State, seed);

        /// <summary>Delay of the change of rate [s].</summary>
        public double Delay => Native.foten_delay_s(State);

        public void Dispose()
        {
            Native.foten_state_free(pointer); // NULL is nothing
            pointer = IntPtr.Zero;
            GC.KeepAlive(texture);
        }
    }

    internal static class Native
    {
#if UNITY_IOS && !UNITY_EDITOR
        private const string Library = "__Internal";
#else
        private const string Library = "foten";
#endif

        [StructLayout(LayoutKind.Sequential)]
        internal struct Options
        {
            public double rate_hz;
            public ulong seed, stream;
            public int deterministic, smooth;
        }

        [StructLayout(LayoutKind.Sequential)]
        internal struct Info
        {
            public IntPtr model, texture;
            public double rate_hz;
            public int window, has_excitation;
            public double speed_low, speed_high, force_low, force_high, acceleration_sd, lowpass_hz;
            public UIntPtr state_bytes;
            public int asks_predictor;
        }

        internal const int Abi = 7; // FOTEN_ABI of the header that this follows

        [DllImport(Library)] internal static extern int foten_abi();
        [DllImport(Library)] internal static extern int foten_model_load(byte[] bytes, UIntPtr n, out IntPtr model, byte[] why, UIntPtr whySize);
        [DllImport(Library)] internal static extern void foten_model_free(IntPtr model);
        [DllImport(Library)] internal static extern Info foten_model_info(IntPtr model);
        [DllImport(Library)] internal static extern IntPtr foten_state_new(IntPtr model, ref Options options);
        [DllImport(Library)] internal static extern void foten_state_free(IntPtr state);
        [DllImport(Library)] internal static extern void foten_reset(IntPtr state, ulong seed);
        [DllImport(Library)] internal static extern void foten_set_condition(IntPtr state, float speed, float force);
        [DllImport(Library)] internal static extern void foten_render(IntPtr state, float[] samples, UIntPtr n);
        [DllImport(Library)] internal static extern double foten_delay_s(IntPtr state);
    }
}
